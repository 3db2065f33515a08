"""Which short sums of words fit samples of a force: a wide search, then each fitted in earnest.

Every word is tried at a grid of constants, and sums of two and three are found by their Gram
matrix. Constants of the best kinds are then fitted by least squares, with the coefficients solved
for (variable projection), and weighed by evidence: misfit, a price for each number, and for each
word.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vidphys.diagnose.formula.grammar import Term, bounds, tries, words

ROUGH = 0.03  # of the force's size: misfits that a grid of constants leaves
FREEDOM, COST = 24, 2.0  # samples that a rough misfit counts as, and a number's price in nats
BEAM = 150  # sums of two that a third is added to
SINGLE, DOUBLE, TRIPLE = 60, 900, 100  # kinds of sums that are fitted in earnest
STARTS = 3
ALIKE = 1e-13  # added to a Gram matrix, for words that are nearly one
CANCEL = 6.0  # times the force's size, that a word may be of
Start = tuple[tuple[float, ...], ...]
ABOVE = 0.03  # of the largest value, from which a variable counts as positive
MOST = 5  # numbers of a sum
NEVER = 1e9
FIRST, STEPS = 4, 30  # of a descent: at first, and in earnest
GIVEN_UP = 40.0  # nats above the best so far
SHORTENED = 40  # sums that are tried without each of their words
EDGE = 1e-3  # of the range of a constant


@dataclass(frozen=True)
class Sum:
    """A sum of words with its numbers.

    Args:
        terms: the words.
        constants: of each word.
        coefficients: of each word, one for each of its columns.
        misfit: squared, in units of the errors.
        score: misfit / 2 and all prices, in nats; less is better.
    """

    terms: tuple[Term, ...]
    constants: tuple[tuple[float, ...], ...]
    coefficients: tuple[tuple[float, ...], ...]
    misfit: float
    score: float

    @property
    def kind(self) -> tuple[str, ...]:
        """Names of the words."""
        return tuple(sorted(term.name for term in self.terms))

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

    def at(self, x: np.ndarray) -> np.ndarray:
        """The force at places."""
        return design(self.terms, self.constants, x) @ np.concatenate(self.coefficients)


def design(
    terms: Sequence[Term], constants: Sequence[tuple[float, ...]], x: np.ndarray
) -> np.ndarray:
    """Columns of all words at places, ``(samples, columns)``."""
    out = np.empty((len(x), sum(len(term.columns) for term in terms)))
    at = 0
    with np.errstate(all="ignore"):
        for term, p in zip(terms, constants, strict=True):
            for of in term.columns:
                out[:, at] = of(x, p)
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


def search(samples: Samples, until: float = np.inf) -> list[Sum]:
    """Sums of one to three words, the best first, one of each kind.

    Args:
        samples: of the force.
        until: time, as :func:`time.thread_time` tells it, at which to stop with what there is.
    """
    vocabulary = words(samples.positive)
    kinds = _kinds(samples, vocabulary)
    found: dict[tuple[str, ...], Sum] = {}

    def look(terms: tuple[Term, ...], start: Start, steps: int) -> None:
        if time.thread_time() > until:
            return
        least = min((one.score for one in found.values()), default=np.inf)
        fit = fitted(samples, terms, start, least, steps)
        if fit is not None and fit.score < found.get(fit.kind, fit).score + 1e-12:
            found[fit.kind] = fit

    for terms, starts in kinds:
        look(terms, starts[0], FIRST)
    near = min((one.score for one in found.values()), default=np.inf) + GIVEN_UP
    for terms, starts in kinds:
        kind = tuple(sorted(term.name for term in terms))
        if any(term.constants for term in terms) and (
            kind not in found or found[kind].score < near
        ):
            for start in starts:
                look(terms, start, STEPS)
    for one in sorted(found.values(), key=lambda one: one.score)[:SHORTENED]:
        for less in one.shorter:
            look(less.terms, less.constants, STEPS)
    return sorted(found.values(), key=lambda one: one.score)


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
    cuts = np.cumsum([len(term.constants) for term in terms])[:-1]
    numbers = sum(term.numbers for term in terms)
    price = numbers / 2 * np.log(samples.count) + sum(term.price for term in terms)

    def parts(flat: np.ndarray) -> list[tuple[float, ...]]:
        return [tuple(piece) for piece in np.split(flat, cuts)]

    def solve(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a = samples.white @ design(terms, parts(flat), samples.x)
        gram = a.T @ a
        scale = np.sqrt(gram.diagonal()) + 1e-300
        gram = gram / scale / scale[:, None] + ALIKE * np.eye(len(scale))
        c = np.linalg.solve(gram, a.T @ y / scale) / scale
        return c, y - a @ c

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
    ends = np.cumsum([len(term.columns) for term in terms])[:-1]
    coefficients = tuple(tuple(piece) for piece in np.split(c, ends))
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
        jacobian = np.stack(
            [(residual(flat + np.where(k, n, 0.0)) - rest) / n for k, n in _each(nudge)], -1
        )
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


def _each(nudge: np.ndarray) -> list[tuple[np.ndarray, float]]:
    return list(zip(np.eye(len(nudge), dtype=bool), nudge, strict=True))


Kind = tuple[tuple[Term, ...], list[tuple[tuple[float, ...], ...]]]


def _kinds(samples: Samples, vocabulary: tuple[Term, ...]) -> list[Kind]:
    """Kinds of sums that come near, each with the constants to start from."""
    low, high = float(samples.x.min()), float(samples.x.max())
    places = [
        (number, p)
        for number, term in enumerate(vocabulary)
        for p in tries(term, low, high)
        if len(term.columns) == 1
    ]
    x, f = samples.x, samples.f
    # a grid's misfit is coarse: places count alike, with no more than a rough error
    columns = np.concatenate([design([vocabulary[n]], [p], x) for n, p in places], -1)
    norm = np.sqrt(np.mean(columns**2, 0)) + 1e-300
    a, y = columns / norm, f / samples.size
    gram, b = a.T @ a / len(x), a.T @ y / len(x)
    kinds = np.array([number for number, _ in places])
    total = float(np.mean(y**2))
    cost = np.array([COST * vocabulary[n].numbers + vocabulary[n].price for n, _ in places])

    numbers = np.array([vocabulary[n].numbers for n, _ in places])

    def rank(left: np.ndarray, members: np.ndarray) -> np.ndarray:
        misfit = np.log(np.maximum(left, 0) + ROUGH**2)
        twice = (np.diff(np.sort(members, -1), axis=-1) == 0).any(-1)
        many = np.where((numbers[members].sum(-1) > MOST) | twice, np.inf, 0.0)
        return FREEDOM / 2 * misfit + cost[members].sum(-1) + many

    ones = np.arange(len(b))[:, None]
    chosen = _best(rank(total - b**2, ones), kinds[ones], ones, SINGLE)
    left, pairs = _pairs(gram, b, total)
    ranked = rank(left, pairs)
    chosen += _best(ranked, kinds[pairs], pairs, DOUBLE)
    order = _beam(ranked, kinds[pairs])
    left, triples = _third(gram, b, total, pairs[order])
    chosen += _best(rank(left, triples), kinds[triples], triples, TRIPLE)
    out = []
    for group in chosen:
        terms = tuple(vocabulary[places[i][0]] for i in group[0])
        out.append((terms, [tuple(places[i][1] for i in each) for each in group]))
    return out + _waves(samples, vocabulary, low, high)


def _waves(samples: Samples, vocabulary: tuple[Term, ...], low: float, high: float) -> list[Kind]:
    """Words with two columns, alone and with each plain one."""
    wide = [term for term in vocabulary if len(term.columns) > 1]
    plain = [term for term in vocabulary if not term.constants and term.power is not None]
    out: list[Kind] = []
    for term in wide:
        starts = tries(term, low, high)[::4]
        out.append(((term,), [(p,) for p in starts]))
        out += [((term, other), [(p, ()) for p in starts]) for other in plain if other.power]
    return out


def _pairs(gram: np.ndarray, b: np.ndarray, total: float) -> tuple[np.ndarray, np.ndarray]:
    """What all sums of two columns leave, and their numbers ``(pairs, 2)``."""
    i, j = np.triu_indices(len(b), 1)
    g = gram[i, j]
    det = 1 - g**2
    gain = (b[i] ** 2 + b[j] ** 2 - 2 * g * b[i] * b[j]) / np.maximum(det, 1e-12)
    left = np.where(det > 1e-5, total - gain, total)
    return left, np.stack([i, j], -1)


def _beam(ranked: np.ndarray, kinds: np.ndarray) -> np.ndarray:
    """The best pairs, few of a kind."""
    order = np.argsort(ranked)[: 40 * BEAM]
    seen: dict[tuple[int, ...], int] = {}
    kept = []
    for index in order:
        kind = tuple(sorted(kinds[index]))
        seen[kind] = seen.get(kind, 0) + 1
        if seen[kind] <= STARTS:
            kept.append(index)
        if len(kept) == BEAM:
            break
    return np.array(kept)


def _third(
    gram: np.ndarray, b: np.ndarray, total: float, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What sums of three leave: each pair with each further column."""
    left, triples = [], []
    for i, j in pairs:
        two = [i, j]
        inverse = np.linalg.inv(gram[np.ix_(two, two)])
        cross = gram[two]
        rest = 1 - np.einsum("ik,ij,jk->k", cross, inverse, cross)
        over = b - cross.T @ (inverse @ b[two])
        gain = np.where(rest > 1e-6, over**2 / np.maximum(rest, 1e-12), 0.0)
        left.append(total - b[two] @ inverse @ b[two] - gain)
        triples.append(np.stack([np.full(len(b), i), np.full(len(b), j), np.arange(len(b))], -1))
    return np.concatenate(left), np.concatenate(triples)


def _best(
    ranked: np.ndarray, kinds: np.ndarray, members: np.ndarray, count: int
) -> list[list[tuple[int, ...]]]:
    """Groups of one kind, the best first, each with the few places to start from."""
    ordered = np.sort(kinds, axis=-1)
    code = np.zeros(len(ranked), np.int64)
    for k in range(ordered.shape[1]):
        code = code * (int(kinds.max()) + 1) + ordered[:, k]
    order = np.lexsort((ranked, code))
    first = np.flatnonzero(np.diff(code[order], prepend=-1))
    last = np.append(first[1:], len(order))
    best = np.argsort(ranked[order[first]])[:count]
    return [
        [
            tuple(int(m) for m in members[i])
            for i in order[first[g] : min(first[g] + STARTS, last[g])]
        ]
        for g in best
        if np.isfinite(ranked[order[first[g]]])
    ]
