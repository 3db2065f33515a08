"""What moves in clips, and by which law.

A body on a curve has its place along it as coordinate and a potential of its own, linear in the
coupling; bodies in a plane have a pair law. Friction is there unless the clips are known to have
none, because real motion dies out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from binders import Tracks
from dynamics import (
    HEADS,
    Hamiltonian,
    Head,
    Parameters,
    build,
    terms,
)
from dynamics.ports import LinearFriction
from dynamics.terms import HeadTerm, PotentialTerm
from vidphys.data.charts import Chart, Curve
from vidphys.data.evenness import evenly
from vidphys.errors import InputError
from vidphys.progress import Progress
from vidphys.shooting.step import model_step
from vidphys.training.learner import OnNan
from vidphys.training.tracks import TrackTask, tell_scale, train_by_shooting

FACTORED, UNSTRUCTURED = "factored", "unstructured"
FRICTION = terms.LinearFriction()
SAMPLING = 0.1  # seconds between the positions that a head is trained on
LEAST_SAMPLES = 4
# frames predicted after the two that start a window, and what counts as precise (coordinate
# units): encounters of bodies in a plane are not foretold for longer
AHEAD = {"curve": 8, "plane": 2}
PRECISE = {"curve": 0.1, "plane": 0.01}


@dataclass(frozen=True)
class Followed:
    """A track, and the law that held.

    Args:
        track: world units, ``(1, t, n, 2)``, as a camera without drift would have seen it.
        law: batch of one.
    """

    track: Tracks
    law: Parameters

    def until(self, end: int) -> Followed:
        """Of its frames before that one, at even times."""
        return Followed(evenly(self.track, end), self.law)


@dataclass(frozen=True)
class Samples:
    """Stretches of equal length that heads are trained on.

    Args:
        tracks: coordinates of the chart, ``(b, s, n, d)``.
        law: of each stretch.
        interval: seconds between samples.
    """

    tracks: Tracks
    law: Parameters
    interval: float


@dataclass(frozen=True)
class Dynamics:
    """Fitted models, and what they are models of.

    Args:
        chart: of their coordinates.
        interval: seconds between the samples that they were fitted to.
        terms, heads: by name.
    """

    chart: Chart
    interval: float
    terms: dict[str, HeadTerm]
    heads: dict[str, Head]

    @property
    def dt(self) -> float:
        """Seconds of a model step."""
        return model_step(self.interval)[0]


def terms_of(chart: Chart, bodies: int, friction: bool) -> dict[str, HeadTerm]:
    """The two models: what such a scene requires, and its twin without structure."""
    ports = (FRICTION,) if friction else ()
    potential: PotentialTerm = terms.Mapped() if bodies == 1 else terms.Displacement()
    twin = HEADS[UNSTRUCTURED]
    if isinstance(chart, Curve):
        potential, twin = terms.Mapped(width=32), terms.Residual(width=64)
    return {FACTORED: terms.Hamiltonian(potentials=(potential,), ports=ports), UNSTRUCTURED: twin}


def sample(clips: Sequence[Followed], known: Sequence[int], chart: Chart) -> Samples:
    """Positions :data:`SAMPLING` seconds apart, once from each offset, ending as late as they can.

    Args:
        clips: at least one.
        known: frames of each clip, from its start, that may be looked at; 0 leaves it out.
        chart: of the coordinates.

    Raises:
        InputError: clips too short to show momentum.
    """
    every, interval = sampling(clips[0].track.times)
    begun = [clip.until(end) for clip, end in zip(clips, known, strict=True) if end]
    used = [(clip, len(clip.track.times)) for clip in begun]
    length = min(end for _, end in used) // every
    if length < LEAST_SAMPLES:
        raise InputError(
            f"train: the shortest clip has {min(end for _, end in used)} frames to train on, "
            f"{length} samples {interval:.3g} s apart; the dynamics need {LEAST_SAMPLES}"
        )
    cuts = [(clip, at) for clip, end in used for at in _stretches(end, every, length)]
    coordinates = torch.cat([chart.coordinate(clip.track.positions[:, at]) for clip, at in cuts])
    sure = torch.cat([clip.track.confidence[:, at] for clip, at in cuts])
    law = Parameters.cat([clip.law for clip, _ in cuts])
    tracks = Tracks(coordinates, sure, interval * torch.arange(length, dtype=torch.float64))
    return Samples(tracks, law, interval)


def sampling(times: Tensor) -> tuple[int, float]:
    """Frames, and seconds, from a sample to the next."""
    frame = float(times.diff().median())
    every = max(1, round(SAMPLING / frame))
    return every, every * frame


def _stretches(end: int, every: int, length: int) -> list[Tensor]:
    """Frame numbers of the stretches before ``end``: of each offset, as many as there is room."""
    span = every * length
    found = []
    for offset in range(every):
        for stop in range(end - offset, span - every, -span):
            found.append(torch.arange(stop - 1 - (length - 1) * every, stop, every))
    return found


def fit_head(
    term: HeadTerm,
    samples: Samples,
    chart: Chart,
    steps: int,
    seed: int,
    save_to: Path | None = None,
    progress: Progress | None = None,
    on_nan: OnNan = "stop",
    device: str = "cpu",
) -> Head:
    """Train a model of this term on the samples.

    Args:
        term, samples: see there.
        chart: decides how far ahead is predicted.
        steps: of the optimiser.
        seed: of initial weights and batch order.
        save_to: folder of checkpoints.
        progress: called as ``(step, steps, loss)``.
        on_nan: see :class:`vidphys.training.learner.FitSettings`.
        device: where it is trained; it comes back from there.
    """
    _, length, bodies, space = samples.tracks.positions.shape
    dt, _ = model_step(samples.interval)
    torch.manual_seed(seed)
    head = build(term, bodies, dt, space).to(device)
    task = TrackTask(
        samples.tracks,
        samples.law,
        samples.interval,
        steps,
        seed,
        min(AHEAD[chart.kind], length - 2),
        PRECISE[chart.kind],
        save_to,
        progress,
        on_nan=on_nan,
    )
    tell_scale(head, task)
    train_by_shooting(head, task)
    return head.cpu().eval()


def friction_of(head: Head) -> float | None:
    """Per second, where the model has any."""
    if not isinstance(head, Hamiltonian):
        return None
    rates = [float(port.rate.detach()) for port in head.ports if isinstance(port, LinearFriction)]
    return rates[0] if rates else None
