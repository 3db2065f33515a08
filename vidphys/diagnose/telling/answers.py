"""Everything that is said of one recording: diagnosed, rolled on, measured, put in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.explanations.explanation import Explanation, Oscillation
from vidphys.diagnose.explanations.forecast import Validation
from vidphys.diagnose.explanations.menu import ASKED, ByMenu
from vidphys.diagnose.explanations.part import understood_part
from vidphys.diagnose.explanations.verdict import EXPLAINED, NOT, RANK
from vidphys.diagnose.recordings.exact import as_measured
from vidphys.diagnose.recordings.flat import in_its_plane, on_its_line
from vidphys.diagnose.recordings.identity import check_identity
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.recordings.nearby import from_nearby
from vidphys.diagnose.recordings.release import free_frames
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.recordings.used import Used
from vidphys.diagnose.telling.advice import Advice, suffices
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.report import about, as_data, summary
from vidphys.diagnose.telling.sufficient import with_measured
from vidphys.diagnose.weak.mending import Mended, without_outliers
from vidphys.diagnose.weak.spectrum import Mode
from vidphys.points.point import Point
from vidphys.progress import Progress
from vidphys.statistics import NORMAL_95, with_error

ARCS = {"pendulum", "double pendulum"}  # terms of what swings on arcs, as it does in a plane only


def answer(
    motion: Motion,
    angles: bool,
    hold_out: float,
    points: Sequence[Point] = (),
    camera: bool = False,
    units: Units | None = None,
    used: Used | None = None,
    progress: Progress | None = None,
) -> Answered:
    """Diagnose a recording, and roll a long one on into a tail that was held out.

    Motion in space that stays in a plane is told in that plane where it swings on an arc there, or
    where it is not explained in space, nor less so in the plane; on a line, by its way along it,
    where that explains it better.
    Places that are counted from far away are told from a place near the motion.
    Of several trials a tail is held out of each; the longest one is rolled on, and drawn.

    Args:
        motion: tracks.
        angles: whether coordinates are joint angles.
        hold_out: share at the end of a long recording of few trials that nothing is fitted to.
        points: measured speed against accuracy, from which integrator and encoder are chosen.
        camera: whether places are in a picture, counted from its middle.
        units: in which lengths are told.
        used: which frames of the recording the motion is of; all of it unless given.
        progress: of the search for a formula, where nothing else explains the recording.

    Raises:
        ValueError: a recording that is too short.
    """
    motion, added = as_measured(motion)
    mended = Mended(motion, 0, 0) if camera else without_outliers(motion)
    motion = mended.motion
    motion, place = (motion, None) if angles else from_nearby(motion)
    told = _told(motion, angles, hold_out, points, camera, units, used, progress)
    if place is not None:
        told = _counted_from(told, place)
    if mended.false_finds:
        told.data["false_finds"] = mended.false_finds
        told.lines.extend(mended.said)
    if added:
        told.data["noise_added"] = added
        told.lines.append(
            "These places are exact, as a simulation's are; they were asked with noise of "
            f"{told.told_in.length(added)}, as a fine instrument has."
        )
    return told


def _told(motion: Motion, *about: Any) -> Answered:
    """In space, or by fewer coordinates; see :func:`answer`."""
    flat, line = in_its_plane(motion), on_its_line(motion)
    if flat is None:
        given = _answer(motion, *about)
        if line is None or given.data["status"] == EXPLAINED:
            return given
        told = _answer(line[0], *about)
        return _laid(told, line[1]) if _rank(told) > _rank(given) else given
    told = _answer(flat[0], *about)
    if told.data["status"] == NOT:
        return _answer(motion, *about)
    if not ARCS & set(told.data["terms"]):
        given = _answer(motion, *about)
        if given.data["status"] == EXPLAINED or _rank(given) > _rank(told):
            return given
    return _laid(told, flat[1])


def _rank(told: Answered) -> int:
    """How well the motion is explained; 0: not."""
    return RANK.index(told.data["status"])


def _laid(told: Answered, axes: np.ndarray) -> Answered:
    """An answer by coordinates along these axes of space, which says so."""
    named = dict(zip("xy", axes.tolist(), strict=False))
    told.data["plane"] = named
    if told.specification is not None:
        told = replace(told, specification=told.specification | {"plane": axes.tolist()})
    where = "on a line" if len(axes) == 1 else "in a plane"
    said = ", ".join(f"{name} along {_direction(axis)}" for name, axis in named.items())
    told.lines.append(f"The motion stays {where}, and is told in it: {said}.")
    return told


def _counted_from(told: Answered, place: np.ndarray) -> Answered:
    """An answer by places counted from there, which says so; its model is of those given."""
    told.data["counted_from"] = place.tolist()
    where = ", ".join(f"{x:.15g}" for x in place)
    told.lines.append(f"Places are counted from ({where}), near which the motion is.")
    if told.specification is None:
        return told
    axes = np.array(told.specification.get("plane", np.eye(len(place))))
    origin = np.array(told.specification["origin"]) + axes @ place
    return replace(told, specification=told.specification | {"origin": origin.tolist()})


def _direction(axis: Sequence[float]) -> str:
    return f"({', '.join(f'{part:.3f}' for part in axis)})"


def _answer(
    motion: Motion,
    angles: bool,
    hold_out: float,
    points: Sequence[Point],
    camera: bool,
    units: Units | None,
    used: Used | None,
    progress: Progress | None,
) -> Answered:
    """As :func:`answer` of the coordinates that were recorded."""
    recorded = motion = _longest_last(motion)
    begin, stop = free_frames(motion)
    used = used or Used(motion.positions.shape[1])
    part = understood_part(motion.cut(begin, stop), hold_out, angles, camera, units, progress)
    motion, understood, later = part.motion, part.understood, part.first
    explanation = understood.explanation
    found, identity = _later(understood.found, used.first + begin + later), check_identity(motion)
    advice = _advice(found, explanation, motion, points)
    told_in = (None if explanation is None else explanation.told_in) or units or Units()
    answered = Answered(
        found,
        summary(found, explanation),
        as_data(found, identity, explanation, advice, told_in),
        None,
        {"noise_sigma": found.noise.sigma},
        recorded.times[-1],
        recorded.positions[-1],
        told_in=told_in,
    )
    said = about(found, identity, advice, answered.told_in)
    lawful = later + (0 if explanation is None else explanation.first)
    then = (later + len(motion.times[0]), part.then)
    _left_out(answered, recorded, used, (begin, stop), lawful, then)
    if understood.no_formula:
        answered.data["no_formula"] = understood.no_formula
        answered.lines.append(f"{understood.no_formula[0].upper()}{understood.no_formula[1:]}.")
    if explanation is None:
        answered.lines.extend(said)
        return answered
    if isinstance(explanation, ByMenu):
        inference = explanation.inference
        answered.probability.update({kind: inference.chance(kind) for kind in ASKED})
        answered.numbers["residual_over_noise"] = float(np.sqrt(inference.leftover.excess))
    answered.data.update(explanation.data())
    answered.numbers.update(explanation.numbers())
    _rolled_on(answered, explanation, motion.positions.shape[1] - part.end)
    answered.lines.extend(said)
    answered = replace(answered, path=_path(answered, explanation))
    scene = explanation.specification()
    if scene is None:
        return answered
    return replace(answered, specification={"mass": found.motion.mass[0].tolist(), **scene})


def _longest_last(motion: Motion) -> Motion:
    """The same trials, the one that shows most frames at the end."""
    shown = motion.seen.any(-1).sum(-1)
    if shown[-1] == shown.max():
        return motion
    return motion.take(np.argsort(shown, kind="stable"))


def _later(found: Diagnosis, frames: int) -> Diagnosis:
    """The same, its frames counted from the recording's first."""
    if found.switch is None:
        return found
    return replace(found, switch=replace(found.switch, frame=found.switch.frame + frames))


def _advice(
    found: Diagnosis, explanation: Explanation | None, motion: Motion, points: Sequence[Point]
) -> Advice | None:
    """By rule, and by what was measured."""
    if explanation is None:
        return None
    by_rule = suffices(explanation.fastest, motion.interval)
    return with_measured(by_rule, motion, found.noise, points) if points else by_rule


def _left_out(
    answered: Answered,
    recorded: Motion,
    used: Used,
    free: tuple[int, int],
    lawful: int,
    then: tuple[int, str],
) -> None:
    """Say which frames are looked at, and why the others are not.

    Args:
        free: the first frame in which nothing holds a body, and the one after the last.
        lawful: frames after that first one, from which one law holds.
        then: frames after that first one, from which it does not any more, and what comes there;
            nothing where it does.
    """
    (first, stop), (begin, end) = recorded.shown(), free
    last, why = recorded.positions.shape[1], []
    noun = "body" if recorded.bodies == 1 else "bodies"
    if stop - first < last:
        answered.data["shown"] = {"first": used.first + first, "last": used.first + stop - 1}
        if used.within(first, stop):
            verb = "is" if recorded.bodies == 1 else "are"
            why.append(
                f"the {noun} {verb} in view from {used.first + first} to {used.first + stop - 1}"
            )
    if begin > first:
        frame = used.first + begin
        answered.data["held_until"] = {"frame": frame, "time": float(recorded.times[0, begin])}
        why.append(f"something holds the {noun} until {frame - 1}")
    if end < stop:
        why.append(f"something holds the {noun} from {used.first + end} on")
    if lawful:
        why.append(f"one law holds from {used.first + begin + lawful} on")
    count, comes = then
    if comes:
        end = begin + count
        why.append(f"after {used.first + end - 1} comes {comes}")
    begin += lawful
    answered.data["frames"] = used.data(begin, end)
    answered.lines.insert(0, used.line(begin, end, why))


def _path(answered: Answered, explanation: Explanation) -> tuple[np.ndarray, np.ndarray] | None:
    """The model's, up to what was held out where that is not foretold by it."""
    path = explanation.path()
    if path is None or not answered.stays:
        return path
    fitted = path[0] < answered.rolled["model"][0][0]
    return path[0][fitted], path[1][fitted]


def _rolled_on(answered: Answered, explanation: Explanation, tail: int) -> None:
    """The model in so many frames that were held out, its oscillations, and under changed laws."""
    follows = explanation.follows
    if follows is not None:
        answered.data["follows_seconds"] = follows
        answered.lines.append(
            f"The model follows the recording for {follows:.3g} s at a time and no longer: "
            "the motion is chaotic, or a term is missing that changes little in so short a time."
        )
    forecast = explanation.forecast() if tail >= LEAST_FRAMES else None
    if forecast is not None:
        _validated(answered, forecast, explanation.stays)
    _oscillations(answered, explanation.oscillations())
    if not answered.stays:
        answered.rolled.update(explanation.changed())


def _validated(answered: Answered, tail: Validation, stays: bool) -> None:
    """The forecast of the tail beside simple ones; it may itself be that the bodies stay."""
    answered.rolled["model"] = tail.times, tail.forecasts["model"]
    answered.data["stays"] = stays
    answered.data["forecast_error"] = tail.errors
    for name, error in tail.errors.items():
        answered.numbers[f"forecast_rmse_{name.replace(' ', '_')}"] = error
    off = {name: answered.told_in.length(error) for name, error in tail.errors.items()}
    others = ", ".join(f"{name} by {error}" for name, error in off.items() if name != "model")
    worse = "" if tail.beats_all or stays else "; it is not better than all of them"
    answered.lines.append(
        f"Over the last {len(tail.times)} frames, which nothing was fitted to, it is off by "
        f"{off['model']} ({others}){worse}."
    )


def _oscillations(answered: Answered, found: Sequence[Oscillation]) -> None:
    """Frequencies and decays: said as fitted; the spectrum's own, which are biased, are data."""
    if not found:
        return
    answered.data["modes"] = [
        {
            "small_frequency": one.small.frequency,
            "small_decay": one.small.decay,
            "small_frequency_error": _known(one.small.frequency_error),
            "small_decay_error": _known(one.small.error),
            "model_frequency": one.model.frequency,
            "model_decay": one.model.decay,
            "spectrum_frequency": one.seen.frequency,
            "spectrum_decay": one.seen.decay,
            "spectrum_decay_error": _known(one.seen.error),
        }
        for one in found
    ]
    for k, one in enumerate(found, 1):
        model, seen = one.model, one.seen
        answered.numbers[f"mode{k}_frequency_ratio"] = model.frequency / seen.frequency
        answered.numbers[f"mode{k}_decay_ratio"] = model.decay / seen.decay
        answered.lines.append(f"Oscillation {k}, about its rest: {_sure_to(one.small)}.")


def _known(error: float) -> float | None:
    return error if np.isfinite(error) else None


def _sure_to(mode: Mode) -> str:
    """Frequency and decay, with their intervals where they are known."""

    def with_interval(value: float, error: float) -> str:
        return with_error(value, NORMAL_95 * error)

    sure = " (95 %)" if np.isfinite(mode.error) else ""
    return (
        f"{with_interval(mode.frequency, mode.frequency_error)} radians per second, its amplitude "
        f"decays by {with_interval(mode.decay, mode.error)} per second{sure}"
    )
