"""The statistics that the study's claims rest on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy  # `scipy.stats` takes a second: loaded where it is asked

MAX_EXACT_PAIRS = 20


def binomial_p(successes: int, seeds: int) -> float:
    """Exact one-sided Pr(X >= successes) under a fair coin per seed.

    Raises:
        ValueError: successes outside 0..seeds, or no seed at all.

    Example:
        >>> binomial_p(10, seeds=10) == 2**-10
        True
    """
    if seeds < 1 or not 0 <= successes <= seeds:
        raise ValueError(f"binomial_p: need 0 <= successes <= seeds, got {successes} of {seeds}")
    return float(scipy.stats.binomtest(successes, seeds, 0.5, alternative="greater").pvalue)


def sign_flip_p(first: Sequence[float], second: Sequence[float]) -> float:
    """Exact two-sided paired sign-flip test of mean(first - second) = 0.

    All 2^n sign patterns are enumerated; the smallest possible p is 2^(1-n).

    Raises:
        ValueError: unequal or empty samples, or more than 20 pairs.

    Example:
        >>> sign_flip_p([0.1, 0.2, 0.3], [1.0, 1.1, 1.3])  # 2 of 2^3 patterns
        0.25
    """
    if len(first) != len(second) or not 0 < len(first) <= MAX_EXACT_PAIRS:
        raise ValueError(
            f"sign_flip_p: need 1 to {MAX_EXACT_PAIRS} pairs, got {len(first)} and {len(second)}"
        )
    difference = np.asarray(first, float) - np.asarray(second, float)
    signs = np.array(list(product((1.0, -1.0), repeat=len(difference))))
    sums = np.abs(signs @ difference)
    slack = 1e-12 * np.abs(difference).sum()
    return float((sums >= abs(difference.sum()) - slack).mean())


def holm(p_values: Sequence[float]) -> list[float]:
    """Step-down adjustment over a declared family, in the order given.

    Holm, Scand. J. Statist. 6, 65 (1979).

    Example:
        >>> [round(p, 3) for p in holm([0.01, 0.04, 0.03])]
        [0.03, 0.06, 0.06]
    """
    order = np.argsort(p_values)
    adjusted, running = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(order):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = running
    return adjusted


@dataclass(frozen=True)
class Interval:
    """Mean and the normal-approximation 95 % interval; bounds are None under five values."""

    mean: float
    low: float | None
    high: float | None
    method: str = "normal-approximation"


NORMAL_95 = 1.96
ROBUST = 1.4826  # times a median absolute deviation is a standard deviation
MIN_FOR_INTERVAL = 5


def normal_interval(values: Sequence[float]) -> Interval:
    """Mean +- 1.96 standard errors, for at least five values.

    Example:
        >>> found = normal_interval([1.0, 2.0, 3.0, 4.0, 5.0])
        >>> round(found.mean, 2), round(found.low, 2), round(found.high, 2)
        (3.0, 1.61, 4.39)
    """
    if not values:
        raise ValueError("normal_interval: no values")
    mean = float(np.mean(values))
    if len(values) < MIN_FOR_INTERVAL:
        return Interval(mean, None, None)
    error = NORMAL_95 * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Interval(mean, mean - error, mean + error)


def paired_difference(first: Sequence[float], second: Sequence[float]) -> Interval:
    """Mean of first - second over pairs, with its interval.

    Raises:
        ValueError: unequal or empty samples.
    """
    if len(first) != len(second) or not len(first):
        raise ValueError(f"paired_difference: got {len(first)} and {len(second)} values")
    return normal_interval((np.asarray(first, float) - np.asarray(second, float)).tolist())


def spearman(first: Sequence[float], second: Sequence[float]) -> float:
    """Rank correlation of two samples, pooled over everything that was evaluated.

    Raises:
        ValueError: fewer than three pairs, a value that is not finite, or a sample that is
            constant, which has no ranks.

    Example:
        >>> round(spearman([1, 2, 3, 4], [10, 100, 50, 1000]), 3)
        0.8
    """
    x, y = np.asarray(first, float), np.asarray(second, float)
    if len(x) != len(y) or len(x) < MIN_FOR_RANKS:
        raise ValueError(f"spearman: need three or more pairs, got {len(x)} and {len(y)}")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ValueError("spearman: a value is not finite; count it as a failure, do not rank it")
    if np.ptp(x) == 0 or np.ptp(y) == 0:
        raise ValueError("spearman: a sample is constant and has no ranks")
    return float(scipy.stats.spearmanr(x, y).statistic)


MIN_FOR_RANKS = 3


@dataclass(frozen=True)
class Ordering:
    """In how many seeds one number was strictly below the other, and how likely by chance."""

    ordered: int
    seeds: int
    p: float


def ordering(lower: Sequence[float], higher: Sequence[float]) -> Ordering:
    """Seeds in which ``lower < higher``, with the exact binomial p; a tie does not count.

    Raises:
        ValueError: unequal or empty samples.
    """
    if len(lower) != len(higher) or not len(lower):
        raise ValueError(f"ordering: got {len(lower)} and {len(higher)} values")
    count = sum(a < b for a, b in zip(lower, higher, strict=True))
    return Ordering(count, len(lower), binomial_p(count, len(lower)))


@dataclass(frozen=True)
class RatioBar:
    """A ratio fixed before a run, which every seed has to reach.

    Args:
        at_least: the ratio, > 0.
    """

    at_least: float

    def __post_init__(self) -> None:
        if not self.at_least > 0:
            raise ValueError(f"RatioBar: at_least must be > 0, got {self.at_least}")

    def holds(self, above: Sequence[float], below: Sequence[float]) -> bool:
        """Whether ``above / below`` reaches the bar in every seed; a NaN never does.

        Raises:
            ValueError: unequal or empty samples.
        """
        if len(above) != len(below) or not len(above):
            raise ValueError(f"RatioBar: got {len(above)} and {len(below)} values")
        return all(a >= self.at_least * b for a, b in zip(above, below, strict=True))


def with_error(value: float, error: float) -> str:
    """A value and its error to the error's second digit; the value alone where none is known.

    Example:
        >>> with_error(2.203123, 0.000281), with_error(2276.2, 163.0)
        ('2.20312 ± 0.00028', '2280 ± 160')
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return f"{value:.4g}"
    places = 1 - math.floor(math.log10(error))
    if not -3 <= places <= 6:
        return f"{value:.4g} ± {error:.2g}"
    after = max(places, 0)
    return f"{round(value, places):.{after}f} ± {round(error, places):.{after}f}"


def as_ratio(values: np.ndarray) -> str:
    """Values over the first of them, to three digits.

    Example:
        >>> as_ratio(np.array([3.0, 1.0]))
        '1 : 0.333'
    """
    return " : ".join(f"{x:.3g}" for x in values / values[0])


def noise_of(positions: np.ndarray) -> float:
    """Standard deviation of the noise of a coordinate, from third differences.

    It is robust against what is broken; infinite where fewer than four frames in a row are seen.

    Args:
        positions: of evenly spaced frames, ``(t, ...)``; NaN where nothing was seen.
    """
    third = np.diff(positions, 3, axis=0)
    third = third[np.isfinite(third)]
    return float(ROBUST * np.median(np.abs(third)) / np.sqrt(20)) if len(third) else np.inf
