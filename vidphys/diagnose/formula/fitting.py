"""The best numbers of a sum: its constants by descent, its coefficients solved for at each step.

Sums are weighed by evidence: misfit, a price for each number, and for each word (variable
projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from vidphys.diagnose.formula.grammar import Term, bounds
from vidphys.diagnose.formula.sums import Samples, Sum, design

Start = tuple[tuple[float, ...], ...]
ALIKE = 1e-13  # added to a Gram matrix, for words that are nearly one
CANCEL = 6.0  # times the force's size, that a word may be of
STEPS = 30  # of a descent, in earnest
GIVEN_UP = 40.0  # nats above the best so far
EDGE = 1e-3  # of the range of a constant


@np.errstate(over="ignore", invalid="ignore")  # trials of no use are given up
def fitted(
    samples: Samples,
    terms: tuple[Term, ...],
    start: Start,
    least: float = np.inf,
    steps: int = STEPS,
) -> Sum | None:
    """A sum of these words with its best numbers; ``None`` where they are beyond belief.

    Args:
        samples: what it is fitted to.
        terms: the words.
        start: their constants at first.
        least: score of another sum, far above which this one is given up early.
        steps: of the descent, at most.
    """
    y = samples.white @ samples.f
    low, high = float(samples.x.min()), float(samples.x.max())
    spans = [bounds(term, low, high) for term in terms]
    lows, highs = (np.array([v for span in spans for v in span[k]]) for k in (0, 1))
    ends = np.cumsum([0, *(len(term.constants) for term in terms)]).tolist()
    numbers = sum(term.numbers for term in terms)
    price = numbers / 2 * np.log(samples.count) + sum(term.price for term in terms)

    def parts(flat: np.ndarray) -> list[tuple[float, ...]]:
        return [tuple(flat[begin:end].tolist()) for begin, end in pairwise(ends)]

    def solve(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients ``(…, c)`` and what is missed ``(…, k)``, of constants ``(…, n)``."""
        several = [[flat[..., n, None] for n in range(*span)] for span in pairwise(ends)]
        a = samples.white @ design(terms, several, samples.x)
        across = a.swapaxes(-1, -2)
        gram, pulled = across @ a, (across @ y)[..., None]
        scale = np.sqrt(gram.diagonal(axis1=-2, axis2=-1))[..., None] + 1e-300
        gram = gram / scale / scale.swapaxes(-1, -2) + ALIKE * np.eye(gram.shape[-1])
        c = np.linalg.solve(gram, pulled / scale) / scale
        return c[..., 0], y - (a @ c)[..., 0]

    flat = np.array([v for p in start for v in p])
    hopeless = 2 * (least + GIVEN_UP - price)
    if len(flat):
        flat = _descend(
            lambda p: solve(p)[1], np.clip(flat, lows, highs), lows, highs, hopeless, steps
        )
    c, rest = solve(flat)
    misfit = float(rest @ rest)
    edge = EDGE * (highs - lows)
    at_edge = bool(((flat - lows < edge) | (highs - flat < edge)).any())
    sizes = np.abs(c) * np.sqrt(np.mean(design(terms, parts(flat), samples.x) ** 2, 0))
    if at_edge or not np.isfinite(misfit) or sizes.max() > CANCEL * samples.size:
        return None
    cuts = np.cumsum([len(term.columns) for term in terms])[:-1]
    coefficients = tuple(tuple(piece) for piece in np.split(c, cuts))
    return Sum(terms, tuple(parts(flat)), coefficients, misfit, float(misfit / 2 + price))


def _descend(
    residual: Callable[[np.ndarray], np.ndarray],
    flat: np.ndarray,
    lows: np.ndarray,
    highs: np.ndarray,
    hopeless: float,
    steps: int,
) -> np.ndarray:
    """Damped Gauss-Newton steps within bounds; the places that they end at."""
    rest = residual(flat)
    misfit, damping = float(rest @ rest), 1e-2
    for step in range(steps):
        nudge = 1e-5 * (np.abs(flat) + 1e-2)
        jacobian = (residual(flat + np.diag(nudge)) - rest).T / nudge
        scale = np.linalg.norm(jacobian, axis=0) + 1e-12
        normal = (jacobian / scale).T @ (jacobian / scale)
        ahead = -((jacobian / scale).T @ rest)
        gained = 0.0
        for _ in range(6):
            move = np.linalg.solve(normal + damping * np.eye(len(flat)), ahead) / scale
            tried = np.clip(flat + move, lows, highs)
            new = residual(tried)
            gained = misfit - float(new @ new)
            if gained > 0:
                flat, rest, misfit = tried, new, misfit - gained
                damping = max(damping / 5, 1e-8)
                break
            damping *= 8
        if gained < 1e-3 * (1 + 1e-3 * misfit):
            break
        if step >= 5 and misfit > hopeless and gained < 0.2 * misfit:
            break
    return flat
