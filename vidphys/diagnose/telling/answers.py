"""Everything that is said of one recording: diagnosed, rolled on, measured, put in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis, diagnose_motion
from vidphys.diagnose.inference.longer import LongFit
from vidphys.diagnose.recordings.identity import check_identity
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.recordings.release import free_frames
from vidphys.diagnose.telling.advice import Advice, advise, suffices
from vidphys.diagnose.telling.forecast import (
    Validation,
    changed_laws,
    last_state,
    roll,
    validate,
)
from vidphys.diagnose.telling.report import ASKED, as_data, summary
from vidphys.diagnose.telling.specification import specification
from vidphys.diagnose.telling.sufficient import with_measured
from vidphys.diagnose.wall.beside import SAMPLES, BesideWall
from vidphys.diagnose.weak.spectrum import Mode, distinct, modes_of_data, modes_of_model
from vidphys.diagnose.weak.windows import FEW
from vidphys.points.point import Point
from vidphys.statistics import NORMAL_95

BLANK = 160  # pixels of a recording's pictures where there is no clip


@dataclass(frozen=True)
class Answered:
    """A diagnosis with all that is written of it.

    Args:
        found: the diagnosis, of the part before the tail that is held out.
        lines: for a person.
        data: as JSON.
        specification: of the scene, where there is one.
        numbers: for the records, by metric.
        times, positions: of the first clip, all of it.
        probability: of each term.
        rolled: times and positions past the fitted part, ``model`` and changed laws.
    """

    found: Diagnosis
    lines: list[str]
    data: dict[str, Any]
    specification: dict[str, Any] | None
    numbers: dict[str, float]
    times: np.ndarray
    positions: np.ndarray
    probability: dict[str, float] = field(default_factory=dict)
    rolled: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    def showcase(self, frames: np.ndarray | None) -> dict[str, np.ndarray] | None:
        """Arrays of the recording; ``None`` where there is no plane to draw, or no forecast."""
        if self.positions.shape[-1] > 2 or "model" not in self.rolled:
            return None
        when, path = self.rolled["model"]
        extent = float(np.nanmax(np.abs(self.positions))) * 1.1
        if frames is None:
            frames = np.full((len(self.times), BLANK, BLANK, 3), 255, np.uint8)
        else:
            extent = 1.0  # normalised image units
        arrays = {
            "frames": frames,
            "frame_times": self.times,
            "readout": _plane(self.positions),
            "rollout": _plane(path),
            "rollout_times": when,
            "half_extent": np.asarray(extent),
            "train_end": np.asarray(when[0]),
        }
        changed = next((name for name in self.rolled if name != "model"), None)
        if changed is not None:
            arrays["changed_times"], arrays["changed"] = (
                self.rolled[changed][0],
                _plane(self.rolled[changed][1]),
            )
        return arrays


def _plane(positions: np.ndarray) -> np.ndarray:
    """Positions of one dimension drawn on the horizontal axis."""
    if positions.shape[-1] == 2:
        return positions
    return np.concatenate([positions, np.zeros_like(positions)], -1)


def answer(motion: Motion, angles: bool, hold_out: float, points: Sequence[Point] = ()) -> Answered:
    """Diagnose a recording, and roll a long one on into a tail that was held out.

    Args:
        motion: tracks.
        angles: whether coordinates are joint angles.
        hold_out: share at the end of a single long clip that nothing is fitted to.
        points: measured speed against accuracy, from which integrator and encoder are chosen.

    Raises:
        ValueError: a recording that is too short.
    """
    recorded, (begin, stop) = motion, free_frames(motion)
    motion = motion.cut(begin, stop)
    total = motion.positions.shape[1]
    end = total
    if motion.clips == 1 and total - int(hold_out * total) > FEW:
        end = total - int(hold_out * total)
    found = _later(diagnose_motion(motion.cut(0, end), angles), begin)
    identity = check_identity(motion)
    inference, wall = found.inference, _wall(found, motion, end)
    advice = _advice(found, wall, motion, points)
    answered = Answered(
        found,
        summary(found, identity, advice, wall),
        as_data(found, identity, advice),
        None,
        {"noise_sigma": found.noise.sigma},
        recorded.times[0],
        recorded.positions[0],
    )
    _left_out(answered, recorded, begin)
    if inference is None:
        return answered
    answered.probability.update({kind: inference.chance(kind) for kind in ASKED})
    answered.numbers["residual_over_noise"] = float(np.sqrt(inference.leftover.excess))
    if wall is not None:
        described = wall.specification()
        _walled(answered, wall)
    else:
        described = specification(inference, motion.interval)
        if found.look is not None:
            _rolled_on(answered, motion, end, found.look)
    described["mass"] = found.motion.mass[0].tolist()
    return replace(answered, specification=described)


def _later(found: Diagnosis, frames: int) -> Diagnosis:
    """The same, its frames counted from the recording's first."""
    if found.switch is None:
        return found
    return replace(found, switch=replace(found.switch, frame=found.switch.frame + frames))


def _wall(found: Diagnosis, motion: Motion, end: int) -> BesideWall | None:
    """A wall that the body strikes, where the menu explains nothing or only by random kicks."""
    if found.inference is None or (found.explained and not found.inference.kicks):
        return None
    return BesideWall.of(motion, end)


def _advice(
    found: Diagnosis, wall: BesideWall | None, motion: Motion, points: Sequence[Point]
) -> Advice | None:
    """By rule, and by what was measured."""
    if found.inference is None:
        return None
    if wall is not None:
        by_rule = suffices(wall.fastest, motion.interval)
    else:
        by_rule = advise(found.inference, motion.interval)
    return with_measured(by_rule, motion, found.noise, points) if points else by_rule


def _left_out(answered: Answered, recorded: Motion, begin: int) -> None:
    """Say which frames were left out, because they show no body or something holds it there."""
    first, stop = recorded.shown()
    noun = "body is" if recorded.bodies == 1 else "bodies are"
    if begin > first:
        time = float(recorded.times[0, begin])
        answered.data["held_until"] = {"frame": begin, "time": time}
        held = (
            f"The {noun} held still until {time:.3g} s (frame {begin}); only the rest is looked at."
        )
        answered.lines.insert(0, held)
    frames = recorded.positions.shape[1]
    if stop - first < frames:
        answered.data["shown"] = {"first": first, "last": stop - 1}
        shown = f"The {noun} in view from frame {first} to {stop - 1} of {frames}."
        answered.lines.insert(0, shown)


def _rolled_on(answered: Answered, motion: Motion, end: int, look: LongFit) -> None:
    """The menu's model in the tail, its oscillations, and its motion under changed laws."""
    if look.windows.frames.shape[1] < end:
        answered.data["follows_seconds"] = look.seconds
        answered.lines.append(
            f"The model follows the recording for {look.seconds:.3g} s at a time and no longer: "
            "the motion is chaotic, or a term is missing that changes little in so short a time."
        )
    if end < motion.positions.shape[1] - LEAST_FRAMES:
        _validated(answered, validate(look, motion.cut(end)))
    _modes(answered, motion, look)
    _changed(answered, look, motion)


def _validated(answered: Answered, tail: Validation) -> None:
    """The forecast of the tail beside simple ones."""
    answered.rolled["model"] = tail.times, tail.forecasts["model"]
    answered.data["forecast_error"] = tail.errors
    for name, error in tail.errors.items():
        answered.numbers[f"forecast_rmse_{name.replace(' ', '_')}"] = error
    others = ", ".join(f"{name} {e:.3g}" for name, e in tail.errors.items() if name != "model")
    worse = "" if tail.beats_all else "; it is not better than all of them"
    answered.lines.append(
        f"Rolled over the {len(tail.times)} frames that nothing was fitted to, the model is off "
        f"by {tail.errors['model']:.3g} ({others}){worse}."
    )


def _walled(answered: Answered, wall: BesideWall) -> None:
    """A wall in place of what the menu has."""
    answered.data["wall"] = wall.data()
    answered.data["terms"] = wall.kinds
    answered.data["explained"] = True
    answered.numbers["wall_restitution"] = wall.fit.wall.restitution
    tail = wall.forecast()
    if tail is not None:
        _validated(answered, tail)
    answered.rolled.update(wall.changed())


def _modes(answered: Answered, motion: Motion, look: LongFit) -> None:
    """Eigenfrequencies and decay: the model's, rolled over the recording, and the data's own."""
    near = np.nanmean(motion.positions[0], axis=0)
    small = distinct(modes_of_model(look.fitted.structure, near, look.windows.mass[0]))
    if not small:
        return
    start, _ = last_state(look)
    first = look.fitted.paths
    begin = type(start)(float(look.windows.begin[0]), first.q[0, 0], first.v[0, 0], start.mass)
    times = motion.times[0][motion.times[0] >= begin.time]
    path = roll(look.fitted.structure, begin, times)
    both = [
        modes_of_data(times, path, len(small)),
        modes_of_data(motion.times[0], motion.positions[0], len(small)),
    ]
    answered.data["modes"] = [
        {
            "small_frequency": tiny.frequency,
            "small_decay": tiny.decay,
            "model_frequency": model.frequency,
            "model_decay": model.decay,
            "spectrum_frequency": seen.frequency,
            "spectrum_decay": seen.decay,
            "spectrum_decay_error": seen.error if np.isfinite(seen.error) else None,
        }
        for tiny, model, seen in zip(small, *both, strict=True)
    ]
    for k, (model, seen) in enumerate(zip(*both, strict=True), 1):
        answered.numbers[f"mode{k}_frequency_ratio"] = model.frequency / seen.frequency
        answered.numbers[f"mode{k}_decay_ratio"] = model.decay / seen.decay
        answered.lines.append(
            f"Oscillation {k}: {model.frequency:.4g} radians per second by the model, "
            f"{seen.frequency:.4g} by the spectrum alone; decay {model.decay:.3g} and "
            f"{_sure_to(seen)} per second."
        )


def _sure_to(mode: Mode) -> str:
    """A measured decay, with its interval where it is known."""
    if not np.isfinite(mode.error):
        return f"{mode.decay:.3g}"
    return f"{mode.decay:.3g} ± {NORMAL_95 * mode.error:.1g} (95 %)"


def _changed(answered: Answered, look: LongFit, motion: Motion) -> None:
    """Roll on under laws that were never recorded."""
    start, _ = last_state(look)
    span = max(float(motion.times[0, -1]) - start.time, 0.3 * look.seconds)
    times = start.time + np.linspace(0, span, SAMPLES)
    for name, law in changed_laws(look.fitted.structure).items():
        answered.rolled[name] = times, roll(law, start, times)
