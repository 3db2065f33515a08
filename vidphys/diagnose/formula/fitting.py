"""The best numbers of many sums at once: constants by descent, coefficients solved at each step.

Sums are weighed by evidence: misfit, a price for each number, and for each word (variable
projection, Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from vidphys.diagnose.formula.grammar import Term, bounds
from vidphys.diagnose.formula.sums import NEVER, Samples, Sum

Start = tuple[tuple[float, ...], ...]
Guess = tuple[tuple[Term, ...], Start]  # words, and their constants at first
ALIKE = 1e-13  # added to a Gram matrix, for words that are nearly one
CANCEL = 6.0  # times the force's size, that a word may be of
STEPS, TRIES = 30, 6  # of a descent, and of a step's damping
GIVEN_UP = 40.0  # nats above the best so far
EDGE = 1e-3  # of the range of a constant


def fitted(
    samples: Samples, guesses: Sequence[Guess], least: float = np.inf, steps: int = STEPS
) -> list[Sum]:
    """Sums with their best numbers; those whose numbers are beyond belief are left out.

    Args:
        samples: what they are fitted to.
        guesses: the words of each, and the constants to start from.
        least: score of another sum, far above which one is given up early.
        steps: of a descent, at most.
    """
    groups = defaultdict(list)
    for terms, start in guesses:
        shape = sum(len(term.constants) for term in terms), sum(len(t.columns) for t in terms)
        groups[shape].append((terms, start))
    return [one for group in groups.values() for one in _Group(samples, group).best(least, steps)]


class _Group:
    """Sums of as many constants ``n`` and columns ``c`` each, fitted side by side.

    Args:
        samples: what they are fitted to, at ``m`` places; ``k`` after whitening.
        guesses: ``b`` of them.
    """

    def __init__(self, samples: Samples, guesses: Sequence[Guess]) -> None:
        self.samples, self.guesses = samples, guesses
        low, high = float(samples.x.min()), float(samples.x.max())
        spans = [[bounds(term, low, high) for term in terms] for terms, _ in guesses]
        self.lows, self.highs = (
            np.array([[v for span in each for v in span[k]] for each in spans]) for k in (0, 1)
        )
        self.price = np.array(
            [
                sum(term.numbers for term in terms) / 2 * np.log(samples.count)
                + sum(term.price for term in terms)
                for terms, _ in guesses
            ]
        )
        self.wanted = samples.white @ samples.f

    @cached_property
    def words(self) -> list[tuple[Term, np.ndarray]]:
        """Each word, and where it stands: sums, their columns and constants, ``(3, uses)``."""
        uses = defaultdict(list)
        for number, (terms, _) in enumerate(self.guesses):
            column = constant = 0
            for term in terms:
                uses[term].append((number, column, constant))
                column, constant = column + len(term.columns), constant + len(term.constants)
        return [(term, np.array(where).T) for term, where in uses.items()]

    def columns(self, flat: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Of sums ``which (g,)`` at trials of their constants ``(g, t, n)``: ``(g, t, c, m)``."""
        count = sum(len(term.columns) for term in self.guesses[0][0])
        out = np.empty((*flat.shape[:2], count, len(self.samples.x)))
        place = np.full(len(self.guesses), -1)
        place[which] = np.arange(len(which))
        for term, (numbers, columns, constants) in self.words:
            here = place[numbers]
            at, column, first = (each[here >= 0] for each in (here, columns, constants))
            p = [flat[at, :, first + k][..., None] for k in range(len(term.constants))]
            for k, of in enumerate(term.columns):
                out[at, :, column + k] = of(self.samples.x, p)
        return np.nan_to_num(out, copy=False, nan=NEVER, posinf=NEVER, neginf=-NEVER)

    def solved(self, flat: np.ndarray, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients ``(g, t, c)`` and what is missed ``(g, t, k)``, as :meth:`columns`."""
        a = self.columns(flat, which) @ self.samples.white.T
        gram, pulled = a @ a.swapaxes(-1, -2), a @ self.wanted
        scale = np.sqrt(gram.diagonal(axis1=-2, axis2=-1)) + 1e-300
        gram = gram / scale[..., None] / scale[..., None, :] + ALIKE * np.eye(gram.shape[-1])
        c = np.linalg.solve(gram, (pulled / scale)[..., None])[..., 0] / scale
        return c, self.wanted - (c[..., None, :] @ a)[..., 0, :]

    @np.errstate(all="ignore")  # trials of no use are given up
    def best(self, least: float, steps: int) -> list[Sum]:
        """The sums whose numbers may be believed."""
        everyone = np.arange(len(self.guesses))
        flat = np.array([[v for part in start for v in part] for _, start in self.guesses], float)
        if flat.shape[1]:
            flat = self._descended(
                np.clip(flat, self.lows, self.highs), 2 * (least + GIVEN_UP - self.price), steps
            )
        (c,), (rest,) = (x.swapaxes(0, 1) for x in self.solved(flat[:, None], everyone))
        misfit = (rest**2).sum(-1)
        plain = self.columns(flat[:, None], everyone)[:, 0]
        sizes = np.abs(c) * np.sqrt(np.mean(plain**2, -1))
        edge = EDGE * (self.highs - self.lows)
        inside = ((flat - self.lows >= edge) & (self.highs - flat >= edge)).all(-1)
        good = inside & np.isfinite(misfit) & (sizes.max(-1) <= CANCEL * self.samples.size)
        return [
            Sum(
                terms,
                _parts(flat[b], [len(term.constants) for term in terms]),
                _parts(c[b], [len(term.columns) for term in terms]),
                float(misfit[b]),
                float(misfit[b] / 2 + self.price[b]),
            )
            for b, (terms, _) in enumerate(self.guesses)
            if good[b]
        ]

    def _descended(self, flat: np.ndarray, hopeless: np.ndarray, steps: int) -> np.ndarray:
        """Damped Gauss-Newton steps within bounds; the places ``(b, n)`` that they end at."""
        going, eye = np.arange(len(flat)), np.eye(flat.shape[1])
        rest = self.solved(flat[:, None], going)[1][:, 0]
        misfit, damping = (rest**2).sum(-1), np.full(len(flat), 1e-2)
        for step in range(steps):
            nudge = 1e-5 * (np.abs(flat[going]) + 1e-2)
            near = flat[going, None] + nudge[..., None] * eye
            jacobian = (self.solved(near, going)[1] - rest[going, None]) / nudge[..., None]
            scale = np.linalg.norm(jacobian, axis=-1) + 1e-12
            jacobian /= scale[..., None]
            normal = jacobian @ jacobian.swapaxes(-1, -2)
            ahead = -(jacobian @ rest[going, :, None])
            gained, left = np.zeros(len(going)), np.arange(len(going))
            for _ in range(TRIES):
                own = going[left]
                damped = normal[left] + damping[own, None, None] * eye
                move = np.linalg.solve(damped, ahead[left])[..., 0] / scale[left]
                tried = np.clip(flat[own] + move, self.lows[own], self.highs[own])
                new = self.solved(tried[:, None], own)[1][:, 0]
                gain = misfit[own] - (new**2).sum(-1)
                won, up = own[gain > 0], gain > 0
                flat[won], rest[won], gained[left[up]] = tried[up], new[up], gain[up]
                misfit[won] -= gain[up]
                damping[own] = np.where(up, np.maximum(damping[own] / 5, 1e-8), damping[own] * 8)
                left = left[~up]
                if not len(left):
                    break
            stopped = gained < 1e-3 * (1 + 1e-3 * misfit[going])
            if step >= 5:
                stopped |= (misfit[going] > hopeless[going]) & (gained < 0.2 * misfit[going])
            going = going[~stopped]
            if not len(going):
                break
        return flat


def _parts(flat: np.ndarray, widths: Sequence[int]) -> tuple[tuple[float, ...], ...]:
    """Numbers ``(n,)``, cut into one tuple for each word."""
    return tuple(tuple(part.tolist()) for part in np.split(flat, np.cumsum(widths)[:-1]))
