"""A motion explained by laws that were fitted to the whole of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vidphys.diagnose.explanations.changed import asked_of, under
from vidphys.diagnose.explanations.explanation import Explanation, Oscillation
from vidphys.diagnose.explanations.forecast import (
    SAMPLES,
    State,
    Validation,
    beside_simple,
    inner_ends,
)
from vidphys.diagnose.explanations.law_data import as_data, wall_of
from vidphys.diagnose.explanations.law_words import (
    beside,
    in_short,
    kept_in_balance,
    tied,
    told,
    what_is_left,
)
from vidphys.diagnose.explanations.rivals import near, rivals, undecided
from vidphys.diagnose.explanations.scene import as_scene
from vidphys.diagnose.explanations.verdict import (
    EXPLAINED,
    MOSTLY,
    NEAR,
    NOT,
    RANK,
    Verdict,
    beyond_noise,
    judge,
)
from vidphys.diagnose.mechanisms.in_step import in_step
from vidphys.diagnose.mechanisms.mechanism import Mechanism, find_mechanism
from vidphys.diagnose.mechanisms.quantities import quantities
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.mechanisms.unfollowed import OwnSwing, alike_every_time, own_swing
from vidphys.diagnose.recordings.balance import masses_in_balance
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import Noise, measure_noise, noise_of
from vidphys.diagnose.recordings.units import Units
from vidphys.statistics import NORMAL_95

STRAIGHT = ("constant velocity", "constant acceleration")  # forecasts, of what nothing acts on
SAME = {  # forecasts that say what a law of such terms says
    frozenset({"collision"}): STRAIGHT,
    frozenset({"dry"}): STRAIGHT[1:],  # until it rests
    frozenset({"uniform"}): STRAIGHT[1:],
}


@dataclass(frozen=True)
class ByMechanism(Explanation):
    """What laws of a mechanism say of a recording.

    Args:
        before: chosen and fitted by the frames before ``end`` alone; it foretells the others.
        mechanism: as all frames choose it, with numbers from those before ``end``.
        whole: the same with numbers from all frames, those that were held out among them.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
        units: in which lengths are told.
        sought: whether the recording is a part of one that was sought for having a law; it is
            mostly explained at most.
    """

    before: Mechanism
    mechanism: Mechanism
    whole: Mechanism
    motion: Motion
    end: int
    units: Units
    sought: bool = False

    @property
    def sure(self) -> bool:
        """Whether it explains all, and no law of other terms is nearly as likely."""
        return self.explained and not any(map(near, self.whole.groups))

    @cached_property
    def told_in(self) -> Units:
        """The units; metres where gravity is known and something hangs or falls."""
        gravity = self.units.gravity
        if gravity is None:
            return self.units
        metres = Units("m", plane=self.units.plane)
        for group in self.whole.groups:
            known = {x.name: x.value for x in quantities(group.fit)}
            if "length" in known and "rate" in known:
                return replace(metres, per=gravity / known["rate"] ** 2 / known["length"])
            if "acceleration" in known and group.fit.model.law.curve is None:  # where it may roll
                return replace(metres, per=gravity / known["acceleration"])
        return self.units

    @property
    def one_law(self) -> bool:
        return len(self.mechanism.groups) == 1

    @property
    def each_by_a_place(self) -> bool:
        models = [group.fit.model for group in self.mechanism.groups]
        about = [
            x.law.restoring in ("trap", "centre") and x.charts[0].name == "plane" for x in models
        ]
        return len(models) > 1 and all(about) and self.balanced is not None

    @property
    def first(self) -> int:
        return self.mechanism.first

    @property
    def noise(self) -> Noise:
        """Of the positions, as the laws leave it."""
        sigma = max(group.fit.errors.white for group in self.mechanism.groups)
        return noise_of(sigma, self.motion)

    @classmethod
    def of(
        cls, motion: Motion, end: int, angles: bool, camera: bool, units: Units
    ) -> ByMechanism | None:
        """The laws of a recording before ``end``, if any can be fitted."""
        before = replace(motion.cut(0, end), ahead=motion.positions[:, end:])
        found = find_mechanism(before, angles, camera)
        return None if found is None else cls(found, *found.refitted(motion), motion, end, units)

    @property
    def kinds(self) -> list[str]:
        return sorted(self.mechanism.kinds)

    def judged(self, tail: Validation | None) -> Verdict:
        """By what the law that the frames before ``end`` chose foretells.

        Where all frames choose another one, what that foretells makes it mostly explained at most.
        """
        judged = self._judged(tail)
        if not self._changes_its_mind:
            return judged
        told = replace(self, before=self.mechanism)
        best = max(judged.status, told._judged(told.rolled_on()).status, key=RANK.index)
        return replace(judged, status=min(best, MOSTLY, key=RANK.index))

    def _judged(self, tail: Validation | None) -> Verdict:
        found = self.before
        same = SAME.get(frozenset(found.kinds), ())
        if "centre" in found.kinds and tail is not None:  # far from the place it goes straight on
            apart = tail.forecasts["model"] - tail.forecasts["constant velocity"]
            if np.linalg.norm(apart, axis=-1).max() < NEAR * found.spread:
                same = STRAIGHT
        judged = judge(found.share, found.left, found.spread, tail, self._period, same, self._bent)
        # A pull of two numbers to an unseen place fits too much: all must be foretold.
        bent = {"centre", "elastic"} & set(found.kinds) and judged.status != EXPLAINED
        if self.impossible or bent:
            return replace(judged, status=NOT)
        partly = judged.status == EXPLAINED and (
            self.sought
            or self.unfollowed
            or undecided(self.whole)
            or self._late
            or self.in_step
            or self.balanced is not None
        )
        return replace(judged, status=MOSTLY) if partly else judged

    @cached_property
    def unfollowed(self) -> dict[int, OwnSwing]:
        """By body: the swing of something that moves with it and was not followed."""
        swings = {g.bodies[0]: own_swing(g.fit) for g in self.whole.groups if len(g.bodies) == 1}
        return {body: swing for body, swing in swings.items() if swing is not None}

    @cached_property
    def in_step(self) -> list[tuple[int, int]]:
        """Bodies that swing in step, two and two: what moves one may move the other."""
        groups = self.whole.groups
        pairs = in_step([group.fit for group in groups]) if len(groups) > 1 else []
        return [(groups[i].bodies[0], groups[j].bodies[0]) for i, j in pairs]

    @cached_property
    def balanced(self) -> np.ndarray | None:
        """Masses of bodies that are told each by itself and keep their balance all the same."""
        alone = len(self.whole.groups) == self.motion.bodies
        return masses_in_balance(self.motion) if alone else None

    @property
    def _changes_its_mind(self) -> bool:
        """Whether the frames that were held out speak for another law than those before them."""
        pairs = zip(self.mechanism.groups, self.before.groups, strict=True)
        return any(told.fit is not blind.fit for told, blind in pairs)

    @property
    def _late(self) -> bool:
        """Whether several bodies have their laws only from a later frame on: they met before."""
        return self.motion.bodies > 1 and self.mechanism.first > 0

    @property
    def _bent(self) -> bool:
        """Whether the force is not quite the law's, of one coordinate, which no lens bends."""
        fit, motion = self.whole.groups[0].fit, self.motion
        if motion.bodies > 1 or motion.space > 1 or fit.model.law.walls:
            return False
        alike = alike_every_time(fit)
        if alike is None:
            return beyond_noise(fit.left, measure_noise(motion).sigma, fit.spread)
        return alike

    @property
    def _period(self) -> float:
        """Seconds of a swing, about: the way round a circle of the motion's size."""
        part = self.motion.cut(0, self.end)
        steps = np.linalg.norm(np.diff(part.positions, axis=1), axis=-1)
        speed = np.nanmean(steps / np.diff(part.times, axis=1)[..., None])
        return 2 * np.pi * self.mechanism.spread / max(float(speed), np.finfo(float).tiny)

    @property
    def fastest(self) -> float:
        return max(
            float(group.fit.model.law.rate({k: v for k, (v, _) in group.fit.numbers.items()}))
            for group in self.mechanism.groups
        )

    def lines(self) -> list[str]:
        alone, whole = self.motion.bodies == 1, self.whole
        out = [line for group in whole.groups for line in told(group, self.told_in, alone)]
        out += [what_is_left(self.mechanism, self.told_in), *rivals(whole)]
        out += [self.impossible] if self.impossible else []
        out += [beside(body, x, self.told_in, alone) for body, x in self.unfollowed.items()]
        out += [tied(*pair) for pair in self.in_step]
        out += [] if self.balanced is None else [kept_in_balance(self.balanced)]
        if self._changes_its_mind:
            same = self.mechanism.kinds == self.before.kinds
            other = "the same terms in another form" if same else in_short(self.before.kinds)
            out.append(
                "All frames choose this law. What is foretold of those held out is by what the "
                f"others choose: {other}."
            )
        if "input" in self.mechanism.kinds:
            out.append("The model that is written has what acts beside its known inputs.")
        if self._from_below:
            out.append("No model of it is written: give the body next to the pivot first.")
        return out

    @property
    def impossible(self) -> str:
        """Why no such law can be, in a sentence; empty where nothing is against it."""
        gains = any(
            value > 1 + NORMAL_95 * error
            for group in self.whole.groups
            for name, (value, error) in group.fit.numbers.items()
            if name.startswith("restitution")
        )
        if not gains:
            return ""
        return "No wall gives back more speed than it takes: something else turns it round."

    def data(self) -> dict[str, Any]:
        groups = self.whole.groups
        held: dict[str, Any] = {"mechanism": [as_data(group, self.told_in) for group in groups]}
        wall = wall_of(groups[0].fit) if self.motion.bodies == 1 else None
        return held if wall is None else {**held, "wall": wall}

    def numbers(self) -> dict[str, float]:
        return {"share_explained": self.mechanism.share}

    def path(self) -> tuple[np.ndarray, np.ndarray] | None:
        windows = len(self.mechanism.begin) - self.motion.clips
        if windows and self.motion.clips > 1:
            return None  # rods', whose windows lie in several trials
        times, clip = self.motion.times[-1], 0 if windows else -1
        times = times[times >= self.mechanism.begin[clip]]
        return times, self.before.path(times, clip)

    def rolled_on(self) -> Validation | None:
        end, times = self.end, self.motion.times[-1]
        if end >= len(times):
            return None
        path = self.before.path(times[end - 3 :])
        h = np.diff(times[end - 3 : end])
        v = (path[2] - path[1]) / h[1]
        a = (v - (path[1] - path[0]) / h[0]) / h.mean()
        start = State(float(times[end - 1]), path[2], v, self.motion.mass[-1])
        return beside_simple(path[3:], self.motion, end, start, a)

    def earlier(self) -> list[ByMechanism]:
        told = replace(self, whole=self.before, motion=self.motion.cut(0, self.end))
        out = []
        for end in inner_ends(self.end, self.motion.positions.shape[1]):
            known = self.before.by_frames_before(self.motion.times[:, end])
            if known is not None:
                out.append(replace(told, before=known, mechanism=known, end=end))
        return out

    def oscillations(self) -> list[Oscillation]:
        return []

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Each law that may be asked for, from the last fitted frame on, while it stays finite."""
        times = self.motion.times[-1]
        stop, last = times[min(self.end, len(times)) - 1], times[-1]
        out, spins = {}, any(group.fit.model.law.spins for group in self.mechanism.groups)
        for name, factor in asked_of(self.mechanism).items():
            # What collisions do with other masses is seen from before they happen, and a spin is
            # known at the beginning.
            again = spins or any(key.startswith("mass") for key in factor)
            start = times[self.mechanism.first] if again else stop
            since = np.linspace(0, last - start + 0.3 * (stop - times[0]), SAMPLES)
            parts = {}
            for group in self.mechanism.groups:
                path = under(group.fit, factor, float(start - self.mechanism.begin[-1]), since)
                parts.update({b: path[:, i] for i, b in enumerate(group.bodies)})
            path = np.stack([parts[b] for b in sorted(parts)], 1)
            stays = int(np.logical_and.accumulate(np.isfinite(path).all((1, 2))).sum())
            if stays > 1:
                out[name] = (start + since[:stays], path[:stays])
        return out

    @property
    def _from_below(self) -> bool:
        """Whether the first of two bodies hangs from the second; a model counts from the pivot."""
        fit = self.whole.groups[0].fit
        return isinstance(fit, RodsFit) and fit.rods.order != (0, 1)

    def specification(self) -> dict[str, Any] | None:
        return (
            None
            if self._from_below
            else as_scene(self.whole, self.motion.interval, self.explained, self.motion.space)
        )
