"""The law of a motion along one coordinate: first a smooth one, then one in closed form."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from vidphys.diagnose.formula.formula import STRANGE, Formula, Verdict, chosen
from vidphys.diagnose.formula.grammar import bounds
from vidphys.diagnose.formula.search import Samples, Sum, search
from vidphys.diagnose.formula.shooting import Fit, Law, fit_stages
from vidphys.diagnose.formula.springs import SPEEDS, Spring, find_spring
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError

TRIED = 10  # formulas that are rolled
BRAKED = 2  # of them that are tried with every friction
HOPELESS = 60.0  # squares beyond those of the smooth law, in units of the noise's
SLIGHTLY = 1e-3  # friction to begin with
PLACES = 32  # at which the smooth force is read
COARSE = 3e-3  # of the force's spread: what splines may miss of a formula


@dataclass(frozen=True)
class FoundLaw:
    """What was found of a motion along one coordinate.

    Args:
        verdict: the formula of its force, or why there is none.
        friction: the terms of the speed: their names, with value and standard error.
        text: the law as it is read, or the reason.
        sigma: noise of the places, in their unit.
        spring: the smooth law behind it; ``None`` where not even that is found.
    """

    verdict: Verdict
    friction: tuple[tuple[str, float, float], ...]
    text: str
    sigma: float
    spring: Spring | None


def law_of(motion: Motion) -> FoundLaw:
    """The law of one body along a line, or of two by the distance between them.

    Args:
        motion: of one coordinate; of two bodies their difference is looked at, whose sign must
            not change.

    Raises:
        InputError: other motions.
    """
    if motion.space != 1 or motion.bodies > 2:
        raise InputError(
            f"law_of: needs one coordinate, or two bodies on a line; got {motion.bodies} bodies in "
            f"{motion.space} dimensions"
        )
    if motion.bodies == 1:
        return coordinate_law(motion.positions[:, :, 0, 0], motion.times)
    apart = motion.positions[:, :, 1, 0] - motion.positions[:, :, 0, 0]
    sign = np.sign(np.nanmedian(apart))
    if np.nanmin(sign * apart) <= 0:
        raise InputError("law_of: the two bodies pass each other; a force along their line jumps")
    return coordinate_law(sign * apart, motion.times, "r")


def coordinate_law(x: np.ndarray, times: np.ndarray, variable: str = "x") -> FoundLaw:
    """The law x'' = f(x) + g(v) of a coordinate.

    Args:
        x: places ``(clips, frames)``, NaN where not seen.
        times: seconds ``(clips, frames)``.
        variable: its name.
    """
    spring = find_spring(x, times)
    if spring is None:
        verdict = Verdict(None, "no formula: no law of place and speed rolls along the recording")
        return FoundLaw(verdict, (), verdict.why, float("nan"), None)
    count = int(spring.pieces.seen.sum())
    found = []
    for one in search(samples_of(spring, count))[:TRIED]:
        law, numbers = _law(one, spring.speeds)
        drags = spring.fit.numbers[spring.basis.count :]
        numbers = np.append(numbers, drags)
        fit = _along(law, numbers, spring.fit.starts, spring)
        if fit is not None:
            found.append(Rolled(one, spring.speeds, fit, count, spring.sigma))
    found = sorted(found, key=lambda each: each.score)
    for each in found[:BRAKED]:
        found += _braked(each, spring)
    if not found:
        verdict = Verdict(None, "no formula: none of the grammar rolls along the recording")
        return FoundLaw(verdict, (), verdict.why, spring.sigma, spring)
    verdict, best = _judged(found, spring, variable)
    friction = _friction(best)
    text = verdict.why
    if verdict.formula is not None:
        told = [f"{value:+.3g} {name}" for name, value, _ in friction]
        text = f"{variable}'' = " + " ".join([verdict.formula.text, *told])
    return FoundLaw(verdict, friction, text, spring.sigma, spring)


def samples_of(spring: Spring, count: int) -> Samples:
    """The smooth force at places that were visited, with its correlated errors."""
    basis = spring.basis
    x = np.linspace(basis.low, basis.high, PLACES)
    splines = basis.matrix(x)
    k = basis.count
    numbers, covariance = spring.fit.numbers[:k], spring.covariance[:k, :k]
    force = splines @ numbers
    floor = (COARSE * np.std(force)) ** 2 * np.eye(len(x))
    values, vectors = np.linalg.eigh(splines @ covariance @ splines.T + floor)
    return Samples(x, force, (vectors / np.sqrt(values)).T, count)


@dataclass(frozen=True)
class Rolled:
    """A sum that was rolled along the recording, with its friction.

    Args:
        sum: the words of the force.
        speeds: the terms of the speed, a key of ``SPEEDS``.
        fit: of all numbers: coefficients, constants, then those of the speed.
        count: frames.
        sigma: noise of the places, of the smooth law.
    """

    sum: Sum
    speeds: str
    fit: Fit
    count: int
    sigma: float

    @property
    def score(self) -> float:
        """Misfit / 2 and all prices, in nats."""
        drags = len(SPEEDS[self.speeds])
        numbers = (self.sum.numbers + drags) / 2 * np.log(self.count)
        return self.fit.squares / self.sigma**2 / 2 + numbers + self.sum.price + drags

    def believed(self, spring: Spring) -> bool:
        """Whether constants are still such as the grammar allows."""
        first = sum(len(part) for part in self.sum.coefficients)
        constants = iter(self.fit.numbers[first:])
        for term in self.sum.terms:
            lows, highs = bounds(term, spring.basis.low, spring.basis.high)
            if not all(a < next(constants) < b for a, b in zip(lows, highs, strict=True)):
                return False
        return True

    def formula(self, variable: str) -> tuple[Sum, Formula]:
        """The sum with the numbers that were rolled, and how it is read."""
        widths = [len(part) for part in (*self.sum.coefficients, *self.sum.constants)]
        flat = self.fit.numbers[: sum(widths)]
        parts = [tuple(part) for part in np.split(flat, np.cumsum(widths)[:-1])]
        words = len(self.sum.terms)
        errors = self.sigma * np.sqrt(np.abs(np.diag(self.fit.inverse)[: sum(widths)]))
        made = Formula(
            self.sum.terms, tuple(parts[words:]), tuple(parts[:words]), tuple(errors), variable
        )
        misfit = self.fit.squares / self.sigma**2
        return (
            replace(
                self.sum,
                coefficients=made.coefficients,
                constants=made.constants,
                misfit=misfit,
                score=self.score,
            ),
            made,
        )


def _law(one: Sum, speeds: str) -> tuple[Law, np.ndarray]:
    """A sum as an acceleration, with friction, and the sum's numbers."""
    widths = [len(part) for part in (*one.coefficients, *one.constants)]
    ends = np.cumsum([0, *widths])
    words = len(one.terms)

    def law(x: np.ndarray, v: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        total = np.zeros_like(x)
        for k, term in enumerate(one.terms):
            constants = tuple(numbers[ends[words + k] : ends[words + k + 1]])
            for j, of in enumerate(term.columns):
                total = total + numbers[ends[k] + j] * of(x, constants)
        for j, of in enumerate(SPEEDS[speeds]):
            total = total + numbers[ends[-1] + j] * of(v)
        return total

    return law, np.concatenate([*one.coefficients, *one.constants])


def _along(law: Law, numbers: np.ndarray, starts: np.ndarray, spring: Spring) -> Fit | None:
    """A law fitted to the recording; ``None`` where it misses more than noise."""
    most = spring.fit.squares + HOPELESS * spring.sigma**2
    return fit_stages(law, numbers, starts, spring.pieces, spring.ties, most=most)


def _braked(rolled: Rolled, spring: Spring) -> list[Rolled]:
    """The same sum with every other friction."""
    out = []
    plain = len(rolled.fit.numbers) - len(SPEEDS[rolled.speeds])
    for speeds, words in SPEEDS.items():
        if speeds == rolled.speeds:
            continue
        law, _ = _law(rolled.sum, speeds)
        numbers = np.append(rolled.fit.numbers[:plain], np.full(len(words), -SLIGHTLY))
        fit = _along(law, numbers, rolled.fit.starts, spring)
        if fit is not None:
            out.append(Rolled(rolled.sum, speeds, fit, rolled.count, rolled.sigma))
    return out


def _judged(found: list[Rolled], spring: Spring, variable: str) -> tuple[Verdict, Rolled]:
    """What the rolls say of each sum, and which stands out."""
    best: dict[tuple[str, ...], Rolled] = {}
    for each in sorted(found, key=lambda each: each.score):
        best.setdefault(each.sum.kind, each)
    told = []
    for each in best.values():
        if not each.believed(spring):
            continue
        worse = (each.fit.squares - spring.fit.squares) / spring.sigma**2
        free = max(spring.basis.count - each.sum.numbers, 1)
        told.append((*each.formula(variable), bool(worse < stats.chi2.isf(STRANGE, free))))
    return chosen(told), next(iter(best.values()))


def _friction(rolled: Rolled) -> tuple[tuple[str, float, float], ...]:
    names = rolled.speeds.split(" + ") if rolled.speeds else []
    errors = rolled.sigma * np.sqrt(np.abs(np.diag(rolled.fit.inverse)))
    first = len(rolled.fit.numbers) - len(names)
    return tuple(
        (name, float(rolled.fit.numbers[first + k]), float(errors[first + k]))
        for k, name in enumerate(names)
    )
