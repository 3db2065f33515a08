"""H1-H3: the statistics that the study's claims rest on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import stats

MAX_EXACT_PAIRS = 20


def binomial_p(successes: int, seeds: int) -> float:
    """H1: exact one-sided Pr(X >= successes) under a fair coin per seed.

    Raises:
        ValueError: successes outside 0..seeds, or no seed at all.
    """
    if seeds < 1 or not 0 <= successes <= seeds:
        raise ValueError(f"binomial_p: need 0 <= successes <= seeds, got {successes} of {seeds}")
    return float(stats.binomtest(successes, seeds, 0.5, alternative="greater").pvalue)


def sign_flip_p(first: Sequence[float], second: Sequence[float]) -> float:
    """H2: exact two-sided paired sign-flip test of mean(first - second) = 0.

    All 2^n sign patterns are enumerated; the smallest possible p is 2^(1-n).

    Raises:
        ValueError: unequal or empty samples, or more than 20 pairs.
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
    """Holm's step-down adjustment over a declared family, in the order given."""
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
MIN_FOR_INTERVAL = 5


def normal_interval(values: Sequence[float]) -> Interval:
    """H3: mean +- 1.96 standard errors (C18), for at least five values."""
    if not values:
        raise ValueError("normal_interval: no values")
    mean = float(np.mean(values))
    if len(values) < MIN_FOR_INTERVAL:
        return Interval(mean, None, None)
    error = NORMAL_95 * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return Interval(mean, mean - error, mean + error)
