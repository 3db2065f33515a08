"""The state at t0 of a clip, read from the frames that lead up to it."""

from __future__ import annotations

import copy
from collections.abc import Callable

import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState
from readouts.differencing import backward_difference
from readouts.shooting import ShootingFit, shoot
from vidphys.perception.aim import PRECISE
from vidphys.perception.base import model_step
from vidphys.training.segments import roll

WINDOWS = (7, 5, 4, 3)  # frames; a shorter window where the longer one cannot be explained
UNUSUAL = 3.0  # times the median residual
FADES = (0.5, 0.7, 1.0)  # weights of a frame against the next that are tried
PRACTICE, AHEAD = 32, 2  # clips and frames that they are tried on


def by_differencing(head: Head, tracks: Tracks, params: Parameters, interval: float) -> PhaseState:
    """The last frame's positions, momentum by a second-order backward difference."""
    return backward_difference(tracks.positions, params.mass.to(tracks.positions), interval)


def choose_fade(head: Head, tracks: Tracks, params: Parameters, interval: float) -> float:
    """The fade under which a head foretells the last frames of some tracks best.

    A head errs the more the further it is rolled, and positions err in every frame: where the one
    is worse, old frames should count little, where the other is, as much as new ones. Nothing but
    tracks is asked.

    Args:
        head: trained.
        tracks: that it was trained on; the first ``PRACTICE`` clips are used, and all but the last
            ``AHEAD`` of their frames to start from.
        params: of each clip.
        interval: seconds between frames.
    """
    few = slice(0, PRACTICE)
    positions, confidence = tracks.positions[few].float(), tracks.confidence[few].float()
    law = params.map(lambda x: x[few].float())
    past = Tracks(positions[:, :-AHEAD], confidence[:, :-AHEAD], tracks.times[:-AHEAD])
    dt, every = model_step(interval)

    def missed(fade: float) -> float:
        start = by_shooting(head, past, law, interval, fade)
        with torch.no_grad():
            ahead = roll(head, start, law, AHEAD, dt, every).q
        error = (ahead - positions[:, -AHEAD:]).square().sum(-1) / PRECISE**2
        return float((confidence[:, -AHEAD:] * error.nan_to_num(nan=torch.inf).log1p()).mean())

    return min(FADES, key=missed)


def by_shooting(
    head: Head, tracks: Tracks, params: Parameters, interval: float, fade: float = FADES[0]
) -> PhaseState:
    """The end of the rollout that passes through the window's positions under the head.

    Episodes whose residual is unusually large (an encounter in the window that the head or the
    binder got wrong) are fitted again on shorter windows that end at the same frame; the one
    with the smallest residual per frame is kept where none is usual.

    Args:
        head: the law.
        tracks: perceived positions.
        params: of each clip.
        interval: seconds between frames.
        fade: weight of a frame against the next one; see :func:`choose_fade`.
    """
    positions, confidence = tracks.positions.double(), tracks.confidence.double()
    params = params.map(torch.Tensor.double)
    best = _fit(head, positions[:, -WINDOWS[0] :], confidence, params, interval, fade)
    state, rmse = best.states[:, -1], best.rmse
    usual = UNUSUAL * float(rmse.median())
    for window in WINDOWS[1:]:
        bad = torch.nonzero(~(rmse <= usual)).squeeze(-1)
        if not len(bad) or window >= positions.shape[1]:
            continue
        few = positions[bad, -window:]
        again = _fit(head, few, confidence[bad], params[bad], interval, fade)
        better = again.rmse < rmse[bad]
        rows = bad[better]
        state.q[rows], state.p[rows] = again.states.q[better, -1], again.states.p[better, -1]
        rmse[rows] = again.rmse[better]
    return state.map(torch.Tensor.float)


def _fit(
    head: Head,
    positions: Tensor,
    confidence: Tensor,
    params: Parameters,
    interval: float,
    fade: float,
) -> ShootingFit:
    a, b, c = positions[:, 0], positions[:, 1], positions[:, 2]
    momentum = params.mass[..., None] * (-3 * a + 4 * b - c) / (2 * interval)
    frames = positions.shape[1]
    weight = fade ** torch.arange(frames - 1, -1, -1.0).to(positions)
    confidence = confidence[:, -frames:].clamp_min(1e-3) * weight[:, None]
    return fit_window(head, positions, PhaseState(a, momentum), params, interval, confidence)


def fit_window(
    head: Head,
    positions: Tensor,
    guess: PhaseState,
    params: Parameters,
    interval: float,
    confidence: Tensor | None = None,
) -> ShootingFit:
    """The rollout of a head that passes through a window, see :func:`readouts.shooting.shoot`.

    It is fitted in double precision, where differences of rollouts are as good as derivatives.
    """
    exact, law = copy.deepcopy(head).double(), params.map(torch.Tensor.double)
    roll = frame_roll(exact, law, interval)
    with torch.no_grad():
        return shoot(
            roll, positions.double(), guess.map(torch.Tensor.double), confidence=confidence
        )


def frame_roll(
    head: Head, params: Parameters, interval: float
) -> Callable[[PhaseState, int], PhaseState]:
    """The head as a function from starts to the states at frames, the starts included.

    Further axes of starts may stand before that of the episodes.
    """
    dt, every = model_step(interval)

    def rolled(start: PhaseState, frames: int) -> PhaseState:
        batch = start.q.shape[:-2]
        law = params.map(lambda x: x.expand(*batch, *x.shape[1:]))
        return head.trajectory(start, law, (frames - 1) * every, dt, every).states

    return rolled
