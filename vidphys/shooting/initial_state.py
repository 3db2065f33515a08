"""The state at t0 of a clip, read from the frames that lead up to it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState
from readouts.differencing import backward_difference, central_difference
from readouts.smoothing import Smoothed, SmoothingSettings, Step, smooth
from vidphys.placement import CPU, moved, suited
from vidphys.shooting.aim import PRECISE
from vidphys.shooting.encounters import PLANE, sought
from vidphys.shooting.step import model_step, roll


@dataclass(frozen=True)
class ShootingSettings:
    """Of the state at t0 that is read by shooting.

    Args:
        windows: frames; a shorter window where the longer one is not explained.
        unusual: times the median cost.
        slacks: of momenta, relative to their size, falling.
        coarse: world units of a position half sure.
        sure: part of its odds at full trust.
        practice, ahead: clips and frames that slacks are tried on.
        worse: slacks in a row, after which no smaller one is tried.
        precise: world units; errors below it count by their square, above by their logarithm.
        passing: windows in which the start of two bodies that pass each other is sought.
        fast: times the largest momentum by differences, up to which it is.
    """

    windows: tuple[int, ...] = (16, 7, 5, 4, 3)
    unusual: float = 2.0
    slacks: tuple[float, ...] = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003)
    coarse: float = 0.02
    sure: float = 0.01
    practice: int = 32
    ahead: int = 2
    worse: int = 2
    precise: float = PRECISE
    passing: tuple[int, ...] = (7, 5)
    fast: float = 1.0
    smoothing: SmoothingSettings = SmoothingSettings()


def by_differencing(head: Head, tracks: Tracks, params: Parameters, interval: float) -> PhaseState:
    """The last frame's positions, momentum by a second-order backward difference."""
    return backward_difference(tracks.positions, params.mass.to(tracks.positions), interval)


def choose_slack(
    head: Head,
    tracks: Tracks,
    params: Parameters,
    interval: float,
    settings: ShootingSettings = ShootingSettings(),
) -> float:
    """The slack under which a head foretells the last frames of some tracks best.

    Positions err and heads err: the better the head, the more all frames of a window say about
    its last one. Nothing but tracks is asked.

    Args:
        head: trained.
        tracks: that it was trained on; the first ``practice`` clips are used, and all but the last
            ``ahead`` of their frames to start from.
        params: of each clip.
        interval: seconds between frames.

    Returns:
        One of ``slacks``, relative to the size of momenta; or infinity, where the dynamics are not
        to be believed at all. So it is where the momenta of states that follow them are mostly
        farther from the differences of frames than none would be: a head without structure may
        mean something of its own by a momentum.
    """
    few, ahead, slacks = slice(0, settings.practice), settings.ahead, settings.slacks
    positions, confidence = tracks.positions[few].float(), tracks.confidence[few].float()
    law = params.map(lambda x: x[few].float())
    past = Tracks(positions[:, :-ahead], confidence[:, :-ahead], tracks.times[:-ahead])
    dt, every = model_step(interval)
    plain = by_differencing(head, past, law, interval)

    def missed(start: PhaseState) -> float:
        strange = (start.p - plain.p).norm(dim=-1).median()
        if not bool(strange <= plain.p.norm(dim=-1).median()):
            return torch.inf
        with torch.no_grad():
            given = suited((start, law), head)
            rolled = roll(head, *given, ahead, dt, every).q.to(positions)
        error = (rolled - positions[:, -ahead:]).square().sum(-1) / settings.precise**2
        return float((confidence[:, -ahead:] * error.nan_to_num(nan=torch.inf).log1p()).mean())

    found = [missed(plain)]
    for fit in _smooth(head, past, law, interval, slacks, settings):
        found.append(missed(fit.states[:, -1]))
        if min(found[1 : -settings.worse], default=torch.inf) <= min(found[-settings.worse :]):
            break
    return (torch.inf, *slacks)[found.index(min(found))]


def by_shooting(
    head: Head,
    tracks: Tracks,
    params: Parameters,
    interval: float,
    slack: float = ShootingSettings.slacks[-1],
    settings: ShootingSettings = ShootingSettings(),
) -> PhaseState:
    """The end of the states that pass through the window's positions, nearly under the head.

    Episodes whose cost is unusual (an encounter in the window that the head or the binder got
    wrong) are fitted again on shorter windows that end at the same frame, also from where
    :mod:`vidphys.shooting.encounters` begins; the one of least cost is kept where none is usual.

    Args:
        head: the law.
        tracks: perceived positions.
        params: of each clip.
        interval: seconds between frames.
        slack: see :func:`choose_slack`.

    Example:
        >>> from dynamics import ballistic
        >>> times = 0.1 * torch.arange(8.0)
        >>> path = torch.stack([times, -times], -1)[None, :, None]  # one clip of one body
        >>> tracks = Tracks(path, torch.ones(1, 8, 1), times)
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1))
        >>> by_shooting(ballistic(), tracks, law, interval=0.1).p.round(decimals=2).tolist()
        [[[1.0, -1.0]]]
    """
    if slack == torch.inf:
        return by_differencing(head, tracks, params, interval)
    slacks = settings.slacks[: settings.slacks.index(slack) + 1]

    def fitted(rows: Tensor | slice, window: int, passing: bool = False) -> Smoothed:
        part = Tracks(
            tracks.positions[rows, -window:],
            tracks.confidence[rows, -window:],
            tracks.times[-window:],
        )
        if not passing:
            *_, last = _smooth(head, part, params[rows], interval, slacks, settings)
            return last
        guess = sought(head, part.positions.double(), params[rows], interval, largest)
        *_, last = _smooth(head, part, params[rows], interval, slacks[-1:], settings, guess)
        return last

    best = fitted(slice(None), settings.windows[0])
    state, cost = best.states[:, -1].map(torch.clone), best.cost.clone()
    usual = settings.unusual * float(cost.median())
    largest = settings.fast * float(best.states.p.norm(dim=-1).max())
    in_plane = tracks.positions.shape[-1] == PLANE and tracks.positions.shape[-2] > 1
    for window in settings.windows[1:]:
        for passing in (False, True) if in_plane and window in settings.passing else (False,):
            bad = torch.nonzero(~(cost <= usual)).squeeze(-1)
            if not len(bad) or window >= tracks.positions.shape[1]:
                continue
            again = fitted(bad, window, passing)
            better = again.cost < cost[bad]
            rows = bad[better]
            state.q[rows], state.p[rows] = again.states.q[better, -1], again.states.p[better, -1]
            cost[rows] = again.cost[better]
    return state.map(torch.Tensor.float)


def _smooth(
    head: Head,
    tracks: Tracks,
    params: Parameters,
    interval: float,
    slacks: Sequence[float],
    settings: ShootingSettings,
    begun: PhaseState | None = None,
) -> Iterator[Smoothed]:
    """The window under a head; slacks are relative to the size of the momenta in it.

    It begins with differences of frames where no states are given.
    """
    positions, law = tracks.positions.double(), params.map(torch.Tensor.double)
    ends = -3 * positions[:, 0] + 4 * positions[:, 1] - positions[:, 2]
    first = law.mass[..., None] * ends / (2 * interval)
    last = backward_difference(positions, law.mass, interval).p
    inner = central_difference(positions, law.mass, interval).p
    momenta = torch.cat([first[:, None], inner, last[:, None]], 1)
    size = float(momenta.square().mean().sqrt()) or 1.0
    confidence = tracks.confidence.double().clamp(1e-3, 1)
    error = settings.coarse * (1 / confidence - 1 + settings.sure).sqrt()
    guess, law = suited((begun or PhaseState(positions, momenta), law), head)
    step = frame_step(head, law, interval)
    positions, error = moved((positions, error), guess.q.device)
    with torch.no_grad():
        scaled = [size * s for s in slacks]
        for each in smooth(step, positions, error, guess, interval, scaled, settings.smoothing):
            yield moved(each, CPU)


def frame_step(head: Head, params: Parameters, interval: float) -> Step:
    """The head as a function from starts of some episodes to their states a frame later.

    Further axes of starts may stand before that of the episodes.
    """
    dt, every = model_step(interval)

    def later(start: PhaseState, rows: Tensor) -> PhaseState:
        batch = start.q.shape[:-2]
        law = params[rows].map(lambda x: x.expand(*batch, *x.shape[1:]))
        states = head.trajectory(start, law, every, dt, every).states
        return states.map(lambda x: x[..., 1, :, :])

    return later
