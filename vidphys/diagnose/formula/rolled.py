"""A sum of words that was rolled along a recording, with what goes with the speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.formula.formula import Formula
from vidphys.diagnose.formula.grammar import bounds
from vidphys.diagnose.formula.shooting import Fit, Law, Pieces, fit_law
from vidphys.diagnose.formula.springs import BY_PLACE, EVERYWHERE, SPEEDS, Spring, find_spring
from vidphys.diagnose.formula.sums import Sum, design

NUDGE = 1e-6  # of a constant, by which derivatives are read
SLIGHTLY = 1e-3  # friction to begin with
SHARP = 4  # steps in a frame interval, at least, where a force's slope jumps
HOPELESS = 60.0  # squares beyond those of the smooth law, in units of the noise's


@dataclass(frozen=True)
class Rolled:
    """A sum that was rolled along the recording, with its friction.

    Args:
        sum: the words of the force.
        speeds: the terms of the speed, a key of ``SPEEDS``.
        fit: of all numbers: coefficients, constants, then those of the speed.
        spring: the smooth law of the same recording.
    """

    sum: Sum
    speeds: str
    fit: Fit
    spring: Spring

    @property
    def score(self) -> float:
        """Misfit / 2 and all prices, in nats."""
        drags = len(SPEEDS[self.speeds])
        numbers = (self.sum.numbers + drags) / 2 * np.log(self.spring.count)
        return self.fit.squares / self.spring.sigma**2 / 2 + numbers + self.sum.price + drags

    @property
    def believed(self) -> bool:
        """Whether constants are still such as the grammar allows."""
        basis = self.spring.basis
        first = sum(len(part) for part in self.sum.coefficients)
        constants = iter(self.fit.numbers[first:])
        for term in self.sum.terms:
            lows, highs = bounds(term, basis.low, basis.high)
            if not all(a < next(constants) < b for a, b in zip(lows, highs, strict=True)):
                return False
        return True

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of all numbers."""
        return self.spring.sigma * np.sqrt(np.abs(np.diag(self.fit.inverse)))

    @property
    def friction(self) -> tuple[tuple[str, float, float], ...]:
        """Words of the speed, with value and standard error."""
        words = SPEEDS[self.speeds]
        errors = self.errors[len(self.errors) - len(words) :]
        each = zip(words, self.drags, errors, strict=True)
        return tuple((word, float(value), float(error)) for word, value, error in each)

    @property
    def drags(self) -> np.ndarray:
        """Coefficients of the words of the speed."""
        return self.fit.numbers[len(self.fit.numbers) - len(SPEEDS[self.speeds]) :]

    def formula(self, variable: str) -> tuple[Sum, Formula]:
        """The sum with the numbers that were rolled, and how it is read."""
        widths = [len(part) for part in (*self.sum.coefficients, *self.sum.constants)]
        flat = self.fit.numbers[: sum(widths)]
        parts = [tuple(part) for part in np.split(flat, np.cumsum(widths)[:-1])]
        sizes, constants = tuple(parts[: len(self.sum.terms)]), tuple(parts[len(self.sum.terms) :])
        errors = tuple(self.errors[: sum(widths)])
        made = Formula(self.sum.terms, constants, sizes, errors, variable)
        told = replace(
            self.sum,
            coefficients=sizes,
            constants=constants,
            misfit=self.fit.squares / self.spring.sigma**2,
            score=self.score,
        )
        return told, made

    def path(self, times: np.ndarray) -> np.ndarray:
        """Places at seconds ``(t,)`` that begin with the last clip's first frame."""
        law, _ = law_of_sum(self.sum, self.speeds, self.spring)
        starts, pieces = self.fit.starts[-1:], pieces_for(self.sum, self.spring)
        return law.roll(self.fit.numbers, starts, times[None], pieces.substeps)[0, :-1, 0]

    def without_friction(self) -> Rolled:
        """The same force, and nothing that goes with the speed; it was fitted to nothing."""
        count = len(self.fit.numbers) - len(SPEEDS[self.speeds])
        return replace(self, speeds="", fit=replace(self.fit, numbers=self.fit.numbers[:count]))


def law_of_sum(one: Sum, speeds: str, spring: Spring) -> tuple[Law, np.ndarray]:
    """A sum as an acceleration, with friction, and the sum's numbers."""
    widths = [len(part) for part in (*one.coefficients, *one.constants)]
    ends, words = np.cumsum([0, *widths]), len(one.terms)

    def split(numbers: np.ndarray) -> tuple[np.ndarray, list[tuple[float, ...]]]:
        parts = [tuple(numbers[a:b]) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return numbers[: ends[words]], parts[words:]

    @np.errstate(all="ignore")  # a trial's constants may be beyond belief
    def columns(numbers: np.ndarray, x: np.ndarray) -> np.ndarray:
        sizes, constants = split(numbers)
        plain = design(one.terms, constants, x)
        force, out = plain @ sizes, [plain]
        for k in range(ends[words], len(numbers)):
            nudged = numbers.copy()
            nudged[k] += (nudge := NUDGE * (abs(numbers[k]) + 1e-3))
            other = design(one.terms, split(nudged)[1], x) @ sizes
            out.append(((other - force) / nudge)[:, None])
        return np.concatenate([force[:, None], *out], 1)

    law = Law(columns, SPEEDS[speeds], spring.basis.low, spring.basis.high)
    return law, np.concatenate([*one.coefficients, *one.constants])


def pieces_for(one: Sum, spring: Spring) -> Pieces:
    """A recording's pieces with steps that are short enough for a sum, across zero too."""
    pieces = spring.pieces
    across = spring.basis.low < 0 < spring.basis.high and any(term.sharp for term in one.terms)
    return replace(pieces, substeps=max(pieces.substeps, SHARP)) if across else pieces


def rolled_along(one: Sum, speeds: str, drags: np.ndarray, spring: Spring) -> Rolled | None:
    """A sum fitted to the recording in one roll; ``None`` where it misses more than noise."""
    law, numbers = law_of_sum(one, speeds, spring)
    most = spring.fit.squares + HOPELESS * spring.sigma**2
    numbers = np.append(numbers, drags)
    fit = fit_law(law, numbers, spring.fit.starts, pieces_for(one, spring), most=most)
    return None if fit is None or fit.squares > most else Rolled(one, speeds, fit, spring)


def again(rolled: Rolled, x: np.ndarray, times: np.ndarray) -> Rolled | None:
    """The same sum and friction with numbers from other frames; ``None`` where it misses them.

    Args:
        rolled: its numbers are nearly right.
        x, times: places and seconds of those frames, ``(clips, frames)``.
    """
    spring = find_spring(x, times, [(rolled.spring.speeds,)])
    told, _ = rolled.formula("x")
    return None if spring is None else rolled_along(told, rolled.speeds, rolled.drags, spring)


def braked(rolled: Rolled) -> list[Rolled]:
    """The same sum with every other friction; one that changes with the place, with other such."""
    told, _ = rolled.formula("x")
    known = {word: value for word, value, _ in rolled.friction if rolled.speeds in BY_PLACE}
    others = (
        rolled_along(
            told, speeds, np.array([known.get(word, -SLIGHTLY) for word in words]), rolled.spring
        )
        for speeds, words in (BY_PLACE if rolled.speeds in BY_PLACE else EVERYWHERE).items()
        if speeds != rolled.speeds
    )
    return [other for other in others if other is not None]
