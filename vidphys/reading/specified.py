"""Training a model of exactly the terms that a diagnosis found, on the tracks that it was given."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from binders import Tracks
from dynamics import Parameters
from dynamics.bath import ConstantBath
from dynamics.state import CLOCK
from dynamics.terms import Bath, Each, HeadTerm, Links, TimedTerm
from vidphys.diagnose.recordings.flat import laid
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError
from vidphys.progress import Progress
from vidphys.reading.fitted import Fitted, Rolled, Units, built, even, law_of
from vidphys.reading.seen import Seen
from vidphys.training.baths import measure_bath
from vidphys.training.few import fit_few, is_few
from vidphys.training.learner import OnNan
from vidphys.training.tracks import TrackTask, tell_scale, train_by_shooting

AHEAD = 4  # frames that are predicted after the two that start a window
PRECISE = 0.5  # of the positions' spread: errors below count by their square


@dataclass(frozen=True)
class Trained:
    """A model with its forecast of the frames that it was not trained on.

    Args:
        model: of the specified terms.
        tracks: all of them, by the coordinates of the model.
        forecast: of those frames, in the unit of the tracks; ``None`` where there are none.
        error: root mean squared distance on them, in that unit.
        still: the same for a body that stays where it last was.
    """

    model: Fitted
    tracks: Motion
    forecast: Rolled | None = None
    error: float | None = None
    still: float | None = None


def train_specified(
    term: HeadTerm,
    held: Mapping[str, Any],
    motion: Motion,
    end: int,
    steps: int,
    seed: int,
    progress: Progress | None = None,
    on_nan: OnNan = "stop",
) -> Trained:
    """Train a model of these terms on the frames before ``end``, and roll it over the rest.

    Numbers of terms start where the specification has them. A law of few numbers is fitted by
    least squares over long stretches, a heat bath by how velocities remember, and a network in
    short windows.

    Args:
        term, held: see :func:`vidphys.diagnose.explanations.specification.read_specification`.
        motion: the tracks; frames that are not evenly spaced are read off a spline at even times.
        end: frame to stop before.
        steps: of the optimiser, or rounds of the least squares, at most.
        seed: of initial weights and batch order.
        progress: called as ``(step, steps, loss)``.
        on_nan: see :class:`vidphys.training.learner.FitSettings`.

    Raises:
        FloatingPointError: a loss or a gradient is not finite.
        InputError: tracks of another scene; a law that changes with time beside a network.
    """
    motion = _laid(held, motion)
    known = even(motion.cut(0, end))
    fitted = _untrained(term, held, known, seed)
    if CLOCK in fitted.params.scalars and not is_few(fitted.head):
        raise InputError(
            "fit: a term of this law changes with time and another is a network, which is trained "
            "in short windows that know no time; leave one of the two out of the specification"
        )
    tracks, law = fitted.tracks(known), fitted.law(known)
    interval = known.interval / fitted.units.seconds
    if fitted.kicked:
        fitted = _bathed(fitted, tracks, law, interval)
    elif is_few(fitted.head):
        fit_few(fitted.head, tracks, law, interval, steps, progress)
    else:
        task = TrackTask(tracks, law, interval, steps, seed, AHEAD, PRECISE, progress=progress)
        task = replace(task, on_nan=on_nan)
        tell_scale(fitted.head, task)
        train_by_shooting(fitted.head, task)
    fitted.head.eval()
    if end >= motion.positions.shape[1]:
        return Trained(fitted, motion)
    return _foretold(fitted, known, motion, end)


def at_specified(term: HeadTerm, held: Mapping[str, Any], motion: Motion) -> Fitted:
    """The model at the numbers of its specification, trained on nothing.

    Args:
        term, held: see :func:`vidphys.diagnose.explanations.specification.read_specification`.
        motion: the tracks that the scene was diagnosed from.

    Raises:
        InputError: tracks of another scene, or a model with a network, which has no such numbers.
    """
    fitted = _untrained(term, held, even(_laid(held, motion)), 0)
    if not is_few(fitted.head):
        raise InputError(
            "the specification has a term of unknown form, which must be trained; "
            "run `vidphys fit` and give its folder"
        )
    return fitted


def _laid(held: Mapping[str, Any], motion: Motion) -> Motion:
    """The tracks by the coordinates of the specification, if they are of its scene."""
    motion = laid(motion, held.get("plane"))
    if (motion.bodies, motion.space) != (held["bodies"], held["space"]):
        raise InputError(
            f"fit: the specification is of {held['bodies']} bodies in {held['space']} "
            f"dimensions, the tracks are of {motion.bodies} in {motion.space}"
        )
    return motion


def _untrained(term: HeadTerm, held: Mapping[str, Any], motion: Motion, seed: int) -> Fitted:
    units = Units.of(motion, _of_angles(term))
    scalars: dict[str, float] = {}
    if any(isinstance(part, Bath) for part in term.parts()):
        found = held["numbers"].get("bath: temperature", {}).get("value")
        known = found if found is not None and np.isfinite(found) else 0.0
        scalars["temperature"] = known * (units.seconds / units.length) ** 2
    if any(isinstance(part, TimedTerm) for part in term.parts()):
        scalars[CLOCK] = 0.0
    params = law_of(held.get("mass", [1.0] * motion.bodies), scalars)
    torch.manual_seed(seed)
    head = built(term, units, params, motion.interval, motion.bodies, motion.space)
    origin, seen = np.asarray(held["origin"], float), Seen.of(motion.times[0], motion.positions[0])
    plane = held.get("plane")
    return Fitted(term, head, units, origin, params, motion.interval, seen, plane)


def _of_angles(term: HeadTerm) -> bool:
    """Whether the tracks are angles, which have no unit to be counted in."""
    return isinstance(term, Links) or (isinstance(term, Each) and any(map(_of_angles, term.laws)))


def _bathed(fitted: Fitted, tracks: Tracks, law: Parameters, interval: float) -> Fitted:
    """The bath as the tracks show it, and as it was diagnosed where they do not."""
    baths = [part for part in fitted.head.modules() if isinstance(part, ConstantBath)]
    before = [float(bath.friction(law).detach()) for bath in baths]
    found = measure_bath(fitted.head, tracks, law, interval, before[0] if before else None)
    for bath in baths:
        if found.rate is not None:
            bath.set(found.rate)
    if found.temperature is None:
        return fitted
    return replace(fitted, params=fitted.params.with_scalar("temperature", found.temperature))


def _foretold(fitted: Fitted, known: Motion, motion: Motion, end: int) -> Trained:
    """The tail: by the model, and by a body that stays where it last was seen."""
    positions, times = motion.positions[:, end:], motion.times[:, end:]
    start, began, law = fitted.last(known), known.times[:, -1], fitted.law(known)
    frames = int(np.ceil((times[:, -1] - began).max() / known.interval - 1e-6))
    rolled = [
        fitted.roll(start[[k]], float(began[k]), frames, known.interval, law[[k]])
        for k in range(known.clips)
    ]
    path = np.stack([one.at(when) for one, when in zip(rolled, times, strict=True)])
    seen = np.isfinite(known.positions).all(-1)
    last = (seen * np.arange(1, seen.shape[1] + 1)[:, None]).argmax(1)  # frame, of each body
    clips, bodies = np.ogrid[: known.clips, : known.bodies]
    still = np.broadcast_to(known.positions[clips, last, bodies][:, None], positions.shape)

    def error(guess: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(((guess - positions) ** 2).sum(-1))))

    return Trained(fitted, motion, rolled[0], error(path), error(still))
