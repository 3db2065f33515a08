"""A motion explained by a formula of one coordinate that was found for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics import terms
from dynamics.terms import PortTerm, PotentialTerm
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.forecast import (
    SAMPLES,
    State,
    Validation,
    beside_simple,
    inner_ends,
)
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.explanations.verdict import Verdict, judge
from vidphys.diagnose.formula.formula import Formula
from vidphys.diagnose.formula.laws import FoundLaw, law_of, spoken
from vidphys.diagnose.formula.rolled import Rolled, again
from vidphys.diagnose.formula.springs import BY_PLACE, PLACEWISE
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import Noise, noise_of
from vidphys.diagnose.recordings.units import Units
from vidphys.progress import Progress
from vidphys.statistics import NORMAL_95, with_error

LETTERS = "kcbd"  # of the constants of a word
RATE, PLACE = -1, 1  # powers of the length that constants count in
# what words of the speed are called, and the powers of the length and of the second they count in
DRAGS = {
    "v": ("linear", 0, -1),
    "v |v|": ("square", -1, 0),
    "sgn(v)": ("dry", 1, -2),
    "v^3": ("cubic", -2, 1),
    "x v": ("placewise", -1, -1),
    "x^2 v": ("placewise", -2, -1),
}
CARRIED = ("linear", "square", "dry")  # those that a model has, by themselves
WELL = {"1": 0, "x": 1, "x^2": 2, "x^3": 3}  # words that a well carries, and their powers


@dataclass(frozen=True)
class ByFormula(Explanation):
    """What a formula says of a recording of one body in one coordinate.

    Args:
        law: fitted to the frames before ``end``; it has a formula.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
        units: in which lengths are told.
    """

    law: FoundLaw
    motion: Motion
    end: int
    units: Units

    @staticmethod
    def sought(
        motion: Motion, end: int, units: Units, progress: Progress | None = None
    ) -> ByFormula | str:
        """The formula of a recording before ``end``; or why there is none, in a sentence."""
        law = law_of(motion.cut(0, end), progress)
        return law.text if law.verdict.formula is None else ByFormula(law, motion, end, units)

    @property
    def best(self) -> Rolled:
        assert self.law.best is not None
        return self.law.best

    @property
    def formula(self) -> Formula:
        assert self.law.verdict.formula is not None
        return self.law.verdict.formula

    @property
    def kinds(self) -> list[str]:
        return sorted({"formula", *(DRAGS[word][0] for word, *_ in self.best.friction)})

    @property
    def one_law(self) -> bool:
        return True

    def judged(self, tail: Validation | None) -> Verdict:
        places = self.motion.positions[:, : self.end, 0, 0]
        spread = float(np.sqrt(np.nanmean((places - np.nanmean(places, 1, keepdims=True)) ** 2)))
        left = float(np.sqrt(self.best.fit.squares / self.best.spring.count))
        steps = np.abs(np.diff(places, axis=1)) / np.diff(self.motion.times[:, : self.end], axis=1)
        period = 2 * np.pi * spread / float(np.nanmean(steps))
        return judge(1 - (left / spread) ** 2, left, spread, tail, period)

    @property
    def noise(self) -> Noise:
        return noise_of(self.best.spring.sigma, self.motion)

    @property
    def fastest(self) -> float:
        places = np.linspace(*self.best.spring.basis.ends, 200)
        slope = np.gradient(self.formula.at(places), places)
        return float(np.sqrt(np.abs(slope).max()))

    def lines(self) -> list[str]:
        low, high = self.best.spring.basis.ends
        ends = " ".join([f"{low:.4g} to {high:.4g}", self.units.named(1, 0)]).strip()
        out = [f"Its law, found as a formula for {ends}: {self.law.text}."]
        out += [f"  {word}: " + ", ".join(self._said(x) for x in told) + " (95 %)"
                for word, told in self._words()]  # fmt: skip
        if len(self.law.frictions) > 1:
            names = [spoken(x, "x") or "none" for x in self.law.frictions[1:]]
            out.append(f"Its friction may as well be {' or '.join(names)}; a longer clip tells.")
        if self.specification() is None:
            out.append("No specification is written: no term of a model carries this formula.")
        return out

    def _said(self, x: tuple[str, float, float, str]) -> str:
        name, value, error, unit = x
        return f"{name} {with_error(value, NORMAL_95 * error)} {unit}".strip()

    def _words(self) -> list[tuple[str, list[tuple[str, float, float, str]]]]:
        """Each word, and its numbers: name, value, standard error, unit."""
        formula, out = self.formula, []
        sizes = sum(len(part) for part in formula.coefficients)
        errors, free = list(formula.errors[:sizes]), list(formula.errors[sizes:])
        known = zip(formula.terms, formula.coefficients, formula.constants, strict=True)
        for term, coefficients, constants in known:
            own = [errors.pop(0) for _ in coefficients]
            degree = constants[0] if term.degree is None else term.degree
            unit = self.units.named(1 - float(degree), -2)
            size = float(np.linalg.norm(coefficients) if len(own) > 1 else coefficients[0])
            told = [("times", size, max(own), unit)]
            for letter, kind, value in zip(LETTERS, term.constants, constants, strict=False):
                power = {"place": PLACE, "power": 0, "signed power": 0}.get(kind, RATE)
                told.append((letter, float(value), free.pop(0), self.units.named(power, 0)))
            if len(coefficients) == 2:
                phase = float(np.arctan2(coefficients[1], coefficients[0]))
                told.append(("c", phase, max(own) / size, "rad"))
            out.append((term.text.format(*LETTERS), told))
        for word, value, error in self.best.friction:
            unit = self.units.named(*DRAGS[word][1:])
            out.append((spoken(word, "x"), [("times", value, error, unit)]))
        return out

    def data(self) -> dict[str, Any]:
        words = [
            {
                "word": word,
                "numbers": {
                    name: {"value": value, "standard_error": error, "unit": unit}
                    for name, value, error, unit in told
                },
            }
            for word, told in self._words()
        ]
        return {
            "formula": {
                "equation": self.law.text,
                "words": words,
                "seen": list(self.best.spring.basis.ends),
                "frictions": list(self.law.frictions),
            }
        }

    def numbers(self) -> dict[str, float]:
        return {} if self.verdict is None else {"share_explained": self.verdict.share}

    def path(self) -> tuple[np.ndarray, np.ndarray] | None:
        if self.motion.clips > 1:
            return None
        times = self.motion.times[0]
        return times, self.best.path(times)[:, None, None]

    def rolled_on(self) -> Validation | None:
        end, times = self.end, self.motion.times[-1]
        if end >= len(times) or self.motion.clips > 1:
            return None
        path = self.best.path(times)
        h = np.diff(times[end - 3 : end])
        v = (path[end - 1] - path[end - 2]) / h[1]
        a = (v - (path[end - 2] - path[end - 3]) / h[0]) / h.mean()
        place, speed, bend = (np.full((1, 1), x) for x in (path[end - 1], v, a))
        start = State(float(times[end - 1]), place, speed, self.motion.mass[-1])
        return beside_simple(path[end:, None, None], self.motion, end, start, bend)

    def earlier(self) -> list[ByFormula]:
        part, out = self.motion.cut(0, self.end), []
        for end in inner_ends(self.end, self.motion.positions.shape[1]):
            few = part.cut(0, end)
            best = again(self.best, few.positions[:, :, 0, 0], few.times)
            if best is not None:
                out.append(replace(self, law=replace(self.law, best=best), motion=part, end=end))
        return out

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Without friction, from the first frame on."""
        if not self.best.speeds:
            return {}
        times = self.motion.times[-1]
        times = np.linspace(times[0], times[-1], max(SAMPLES, len(times)))
        path = self.best.without_friction().path(times)
        return {"no friction": (times, path[:, None, None])}

    def specification(self) -> dict[str, Any] | None:
        """The scene, where a well, a pendulum and frictions carry it."""
        potentials = _potentials(self.formula)
        ports = _ports({word: value for word, value, _ in self.best.friction})
        if potentials is None or ports is None:
            return None
        term = terms.Hamiltonian(potentials=potentials, ports=ports)
        numbers = {
            f"{word}: {name}": (value, error)
            for word, told in self._words()
            for name, value, error, _ in told
        }
        return as_specification(term, 1, [0.0], numbers, self.explained, self.motion.interval)


def _ports(friction: dict[str, float]) -> tuple[PortTerm, ...] | None:
    """Terms of the model; ``None`` where none carry a word of the speed."""
    by_place = BY_PLACE[PLACEWISE]
    if friction.keys() - {"v"} and friction.keys() <= set(by_place):
        a, b, c = (-friction.get(word, 0.0) for word in by_place)
        return (terms.PlacewiseFriction((a, b, c)),)
    out = []
    for word, value in friction.items():
        name = DRAGS[word][0]
        if name not in CARRIED or (name != "linear" and value > 0):
            return None
        out.append(terms.Drag(name, "positive" if value < 0 else "free", rate=-value))
    return tuple(out)


def _potentials(formula: Formula) -> tuple[PotentialTerm, ...] | None:
    """Terms of the model; ``None`` where none carry a word."""
    cubic = np.zeros(4)
    out: list[PotentialTerm] = []
    for term, coefficients, constants in zip(
        formula.terms, formula.coefficients, formula.constants, strict=True
    ):
        if term.name in WELL:
            cubic[WELL[term.name]] += coefficients[0]
        elif term.name == "sin":
            out.append(terms.Pendulum(-coefficients[0] * constants[0], 1 / constants[0]))
        else:
            return None
    if cubic.any():
        out.append(terms.Well(-cubic[1], cubic[0], cubic[2], -cubic[3]))
    return tuple(out)
