"""Sums of words with their numbers, and the samples of a force that they are fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vidphys.diagnose.formula.grammar import Term

ABOVE = 0.03  # of the largest value, from which a variable counts as positive
NEVER = 1e9


def kind_of(terms: Sequence[Term]) -> tuple[str, ...]:
    """Names of words, by which sums are compared."""
    return tuple(sorted(term.name for term in terms))


@dataclass(frozen=True)
class Force:
    """A sum of words as a function of the place.

    Args:
        terms: the words.
        constants: of each word.
        coefficients: of each word, one for each of its columns.
    """

    terms: tuple[Term, ...]
    constants: tuple[tuple[float, ...], ...]
    coefficients: tuple[tuple[float, ...], ...]

    @property
    def kind(self) -> tuple[str, ...]:
        """Names of the words."""
        return kind_of(self.terms)

    def at(self, x: np.ndarray) -> np.ndarray:
        """The force at places ``(m,)``."""
        return design(self.terms, self.constants, x) @ np.concatenate(self.coefficients)


@dataclass(frozen=True)
class Sum(Force):
    """A sum of words that was fitted.

    Args:
        terms, constants, coefficients: of :class:`Force`.
        misfit: squared, in units of the errors.
        score: misfit / 2 and all prices, in nats; less is better.
    """

    misfit: float
    score: float

    @property
    def numbers(self) -> int:
        """How many were fitted."""
        return sum(term.numbers for term in self.terms)

    @property
    def price(self) -> float:
        """Of the words, in nats."""
        return sum(term.price for term in self.terms)

    @property
    def shorter(self) -> list[Sum]:
        """The same without each of its words, to be fitted anew."""

        def left(part: tuple[Any, ...], k: int) -> tuple[Any, ...]:
            return part[:k] + part[k + 1 :]

        return [
            Sum(
                left(self.terms, k),
                left(self.constants, k),
                left(self.coefficients, k),
                np.inf,
                np.inf,
            )
            for k in (range(len(self.terms)) if len(self.terms) > 1 else ())
        ]


def design(
    terms: Sequence[Term], constants: Sequence[Sequence[float | np.ndarray]], x: np.ndarray
) -> np.ndarray:
    """Columns of all words at places, ``(…, samples, columns)``.

    Args:
        terms: the words.
        constants: of each, a number or, of many sums at once, ``(…, 1)``.
        x: places, ``(samples,)``.
    """
    lead = np.broadcast_shapes(*(np.shape(p)[:-1] for each in constants for p in each))
    out = np.empty((*lead, len(x), sum(len(term.columns) for term in terms)))
    at = 0
    with np.errstate(all="ignore"):
        for term, p in zip(terms, constants, strict=True):
            for of in term.columns:
                out[..., at] = of(x, p)
                at += 1
    return (
        out
        if np.isfinite(out.sum())
        else np.nan_to_num(out, nan=NEVER, posinf=NEVER, neginf=-NEVER)
    )


@dataclass(frozen=True)
class Samples:
    """Values of a force.

    Args:
        x: places, ``(m,)``.
        f: values, ``(m,)``.
        white: makes their errors independent and of variance one, ``(k, m)``.
        count: observations behind them, that a number is priced by.
    """

    x: np.ndarray
    f: np.ndarray
    white: np.ndarray
    count: int

    @property
    def positive(self) -> bool:
        """Whether places stay above zero."""
        return bool(self.x.min() > ABOVE * np.abs(self.x).max())

    @property
    def size(self) -> float:
        """Of the force."""
        return float(np.sqrt(np.mean(self.f**2)))
