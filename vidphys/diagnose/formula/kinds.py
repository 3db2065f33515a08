"""Which kinds of sums come near a force: every word at a grid of constants, up to three together.

Sums of two and three are found by the Gram matrix of all columns.
"""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.formula.fitting import Start
from vidphys.diagnose.formula.grammar import Term, tries
from vidphys.diagnose.formula.sums import Samples, design

ROUGH = 0.03  # of the force's size: misfits that a grid of constants leaves
FREEDOM, COST = 24, 2.0  # samples that a rough misfit counts as, and a number's price in nats
BEAM = 150  # sums of two that a third is added to
SINGLE, DOUBLE, TRIPLE = 60, 900, 100  # kinds of sums that are fitted in earnest
STARTS = 3
MOST = 5  # numbers of a sum
Kind = tuple[tuple[Term, ...], list[Start]]


def kinds_of(samples: Samples, vocabulary: tuple[Term, ...]) -> list[Kind]:
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
    base = int(kinds.max()) + 1
    code = ordered @ base ** np.arange(ordered.shape[1])[::-1]
    order = np.argsort(ranked)
    short = code[order].astype(np.min_scalar_type(base ** ordered.shape[1]))  # sorts faster
    order = order[np.argsort(short, kind="stable")]
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
