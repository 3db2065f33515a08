"""A motion explained by the terms of the menu, with a switch in mid-clip if there is one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.explanations.doubts import OUTWEIGHED, PASSES, UNTURNED
from vidphys.diagnose.explanations.equations import of_terms
from vidphys.diagnose.explanations.explanation import Explanation, Oscillation
from vidphys.diagnose.explanations.forecast import (
    SAMPLES,
    State,
    Validation,
    beside_simple,
    changed_laws,
    inner_ends,
    last_state,
    roll,
)
from vidphys.diagnose.explanations.menu_model import specification
from vidphys.diagnose.explanations.menu_numbers import number_lines, quantities_of, told_of
from vidphys.diagnose.explanations.pair_words import other_shapes, pair_lines
from vidphys.diagnose.explanations.verdict import (
    MOSTLY,
    RANK,
    Verdict,
    beyond_noise,
    judge,
)
from vidphys.diagnose.inference.doubts import doubts
from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.linearised import fastest_rate, sure_modes
from vidphys.diagnose.inference.longer import LongFit
from vidphys.diagnose.inference.menu import PAIR
from vidphys.diagnose.inference.refine import refine
from vidphys.diagnose.inference.weigh import BELIEVED
from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.weak.paths import splined
from vidphys.diagnose.weak.spectrum import distinct, modes_of_data
from vidphys.diagnose.weak.windows import cut_windows
from vidphys.statistics import NORMAL_95, as_ratio

ASKED = (
    "pair",
    "contact",
    "uniform",
    "trap",
    "well",
    "pendulum",
    "linear",
    "square",
    "dry",
    "drive",
)
PICTURED = "These terms know nothing of cameras: look at what is followed."
RESTING = {"spring", "rest-length", "contact", "lennard-jones"}  # shapes that hold at a distance
STRIDE = 3  # frames, over which a step shows where a body goes
LIKELY, UNLIKELY = 0.9, 0.1
WORDS = {
    "pair": "a force between pairs",
    "contact": "contacts",
    "uniform": "a uniform field",
    "trap": "a trap",
    "well": "a well whose sides differ",
    "pendulum": "a pendulum's weight",
    "linear": "friction that goes with the speed",
    "square": "friction that goes with its square",
    "dry": "dry friction",
    "drive": "a drive that adds energy",
    "bath": "random kicks of a heat bath",
}


@dataclass(frozen=True)
class ByMenu(Explanation):
    """What the menu says of a recording.

    Args:
        found: of the part before ``end``.
        inference: of all of that part.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
        camera: whether the places are of bodies that were followed in a picture.
        units: in which lengths are told.
    """

    found: Diagnosis
    inference: Inference
    motion: Motion
    end: int
    camera: bool = False
    units: Units = Units()

    @property
    def told_in(self) -> Units:
        return self.units

    @property
    def kinds(self) -> list[str]:
        return sorted(self.found.kinds)

    @property
    def explained(self) -> bool:
        return self.found.explained and not (self.strays or self.stays)

    @property
    def strays(self) -> bool:
        """Whether its terms diverge over the frames that were held out: they are no law of it."""
        odd = self.inference.kicks or self.found.parts
        held = self.end < self.motion.positions.shape[1]
        return bool(held and not odd and self._tail is None)

    @property
    def sure(self) -> bool:
        bent = self.verdict is not None and self.verdict.bent
        return self.found.sure and not (bent or self.camera or self.stays)

    @property
    def jolted(self) -> bool:
        """Whether kicks are told of a body in a picture, where whoever follows it errs as well."""
        return self.camera and bool(self.inference.kicks)

    @property
    def passes(self) -> bool:
        """Whether nothing acts on what a camera sees; see :data:`.doubts.PASSES`."""
        return self.camera and not self.kinds

    @property
    def unturned(self) -> bool:
        """Whether a trap turns nothing round that a camera sees; see :data:`.doubts.UNTURNED`."""
        if not self.camera or "trap" not in self.kinds:
            return False
        seen = self.motion.positions[:, : self.end]
        steps = seen[:, STRIDE:] - seen[:, :-STRIDE]
        return not bool(((steps * steps[:, :1]).sum(-1) < 0).any())

    @property
    def fastest(self) -> float:
        return fastest_rate(self.inference)

    @property
    def follows(self) -> float | None:
        look = self.found.look
        short = look is not None and look.windows.frames.shape[1] < self.end
        return look.seconds if look is not None and short else None

    def lines(self) -> list[str]:
        """Which terms the motion shows, and what stays open."""
        found, lines = self.found, []
        if found.switch is not None and found.parts:
            lines.append(
                f"Something changes at {found.switch.time:.4g} s (frame {found.switch.frame}); "
                f"before it: {named(found.parts[0])}; after it: {named(found.parts[1])}."
            )
        else:
            lines.append(f"The motion shows {named(self.inference)}.")
        for part in found.inferences:
            written = of_terms(part, (x.name for x in quantities_of(part))).line
            numbers = number_lines(part, self.units)
            lines += [f"  {x}" for x in (written, *numbers, *pair_lines(part, self.units))]
        lines += [] if found.parts else _uncertain(self.inference)
        lines += self._of_masses()
        if self.strays:
            lines.append("Not explained: rolled on over the frames held out, these terms diverge.")
        if not found.explained:
            left = (part.leftover for part in found.inferences)
            why = "; ".join(x.why for x in left if not x.explained)
            lines.append(f"No term explains all of it: {why}.")
        if self.jolted:
            lines.append("Kicks may be mistakes of who follows the body: look at what is followed.")
        lines += [PICTURED] if self.camera else []
        lines += [PASSES] if self.passes else []
        lines += [UNTURNED] if self.unturned else []
        lines += [] if found.mended is None else found.mended.said
        for part in found.inferences:
            lines += doubts(found.motion, part, found.swaps)
        if found.power is not None:
            lines.append(f"Power of the coupling: {found.power.why}.")
        return lines

    def _of_masses(self) -> list[str]:
        """For which masses numbers are told, and what the heaviest does beside any others."""
        found, mass = self.found, self.found.motion.mass[0]
        if np.allclose(found.motion.mass, 1.0):
            return []
        lines = [f"Masses as {as_ratio(mass)}; motion shows only their ratios."]
        if found.outweighed:
            lines = [OUTWEIGHED.format(ratio=BELIEVED)]
        if "pair" in self.kinds:
            taken = ", ".join(f"{x:.4g}" for x in mass)
            lines.append(f"What acts between the bodies is told for masses of {taken}.")
        pair = self.inference.structure.term(PAIR)
        known = {x.name: x for x in quantities_of(self.inference)}
        number = known.get("pair: strength")  # a molecule's force, a spring of a length have others
        goes_with_mass = pair is not None and pair.source == "mass"
        if found.outweighed and not found.parts and goes_with_mass and number is not None:
            times = float(mass.max())
            others = float(mass.sum()) - times  # how heavy they are is not told as sure
            error = float(np.hypot(times * number.error, others * number.value / NORMAL_95))
            whole = replace(number, value=times * number.value, error=error)
            lines.append(
                f"Times the mass of body {int(mass.argmax()) + 1}, the heaviest, that is "
                f"{told_of(whole, self.units)} (95 %)."
            )
        return lines

    def judged(self, tail: Validation | None) -> Verdict | None:
        """By its forecast, where it can be rolled over frames that were held out."""
        if tail is None:
            return None
        seen = self.motion.cut(0, self.end).positions
        spread = float(
            np.sqrt(np.nanmean(((seen - np.nanmean(seen, 1, keepdims=True)) ** 2).sum(-1)))
        )
        left = float(np.sqrt(self.inference.fitted.variance * self.motion.space))
        alone = self.motion.bodies == 1 and self.motion.space == 1
        bent = alone and beyond_noise(left, self.found.noise.sigma, spread)
        bent = bent or not (self.kinds or self.found.explained)
        judged = judge(1 - (left / spread) ** 2, left, spread, tail, bent=bent)
        told = self.inference
        doubtful = self.camera or _uncertain(told) or other_shapes(told) or told.alone
        most = MOSTLY if doubtful else judged.status
        return replace(judged, status=min(judged.status, most, key=RANK.index))

    def rolled_on(self) -> Validation | None:
        return self._tail

    @property
    def _look(self) -> LongFit:
        return self.found.look or LongFit(self.inference.fitted, self.inference.windows)

    def earlier(self) -> list[ByMenu]:
        part, out = self.motion.cut(0, self.end), []
        for end in inner_ends(self.end, self.motion.positions.shape[1]):
            look = self._before(end)
            found = replace(self.found, look=look)
            out += [] if look is None else [replace(self, found=found, motion=part, end=end)]
        return out

    def _before(self, end: int) -> LongFit | None:
        """The same terms with numbers from fewer frames; ``None`` where these do not tell."""
        size = min(self._look.windows.frames.shape[1], end)
        try:
            fine = self._look.windows.fine
            windows = cut_windows(self.found.motion.cut(0, end), size, fine)
            paths = splined(windows, self.found.noise.sigma)
            fitted = refine(windows, paths, self._look.fitted.structure)
        except (FloatingPointError, np.linalg.LinAlgError, Unseen):
            return None
        return LongFit(fitted, windows)

    @cached_property
    def _tail(self) -> Validation | None:
        if self.end >= self.motion.positions.shape[1] or self.inference.kicks or self.found.parts:
            return None
        look = self._look
        start, a = last_state(look)
        times = self.motion.times[-1, self.end - 1 :]
        try:
            path = roll(look.fitted.structure, start, times)[1:]
        except FloatingPointError:
            return None
        return beside_simple(path, self.motion, self.end, start, a)

    def oscillations(self) -> list[Oscillation]:
        look, motion = self.found.look, self.motion
        if look is None or not _rests(self.inference):
            return []
        near, mass = np.nanmean(motion.positions[0], axis=0), look.windows.mass
        lasts = float(motion.times[0, -1] - motion.times[0, 0])
        every = distinct(sure_modes(look.fitted, near, mass[0]))
        small = [mode for mode in every if mode.frequency * lasts > 1]  # slower ones do not show
        if not small:
            return []
        first = look.fitted.paths
        begin = State(float(look.windows.begin[0]), first.q[0, 0], first.v[0, 0], mass[-1])
        times = motion.times[0][motion.times[0] >= begin.time]
        path = roll(look.fitted.structure, begin, times)
        model = modes_of_data(times, path, len(small))
        seen = modes_of_data(motion.times[0], motion.positions[0], len(small))
        return [Oscillation(*three) for three in zip(small, model, seen, strict=True)]

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        look = self.found.look
        if look is None:
            return {}
        start, _ = last_state(look)
        span = max(float(self.motion.times[0, -1]) - start.time, 0.3 * look.seconds)
        times = start.time + np.linspace(0, span, SAMPLES)
        laws = changed_laws(look.fitted.structure)
        return {name: (times, roll(law, start, times)) for name, law in laws.items()}

    def specification(self) -> dict[str, Any]:
        return specification(self.inference, self.motion.interval)


def _rests(inference: Inference) -> bool:
    """Whether bodies have a place to rest: of those that only fall towards each other none has."""
    shapes = {shape for term in inference.terms for shape in term.shape.split("+")}
    held = {"trap", "well", "pendulum"} & inference.kinds
    return bool(held or shapes & RESTING)


def named(inference: Inference) -> str:
    """The kinds of its terms, in words."""
    kinds = [WORDS.get(kind, kind) for kind in sorted(inference.kinds)]
    return ", ".join(kinds) if kinds else "inertia and nothing else"


def _uncertain(inference: Inference) -> list[str]:
    """Terms that the data neither show nor rule out."""
    open_terms = [
        f"{WORDS[kind]} ({chance:.0%})"
        for kind in ASKED
        if UNLIKELY < (chance := inference.chance(kind)) < LIKELY
    ]
    if not open_terms:
        return []
    return [f"Not certain, record longer or with less noise: {', '.join(open_terms)}."]
