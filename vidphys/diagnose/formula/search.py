"""Which short sums of words fit samples of a force: a wide search, then each fitted in earnest."""

from __future__ import annotations

import time

import numpy as np

from vidphys.diagnose.formula.fitting import GIVEN_UP, STEPS, Start, fitted
from vidphys.diagnose.formula.grammar import Term, words
from vidphys.diagnose.formula.kinds import kinds_of
from vidphys.diagnose.formula.sums import Samples, Sum, kind_of

FIRST = 4  # steps of a descent at first
SHORTENED = 40  # sums that are tried without each of their words


def search(samples: Samples, until: float = np.inf) -> list[Sum]:
    """Sums of one to three words, the best first, one of each kind.

    Args:
        samples: of the force.
        until: time, as :func:`time.thread_time` tells it, at which to stop with what there is.
    """
    vocabulary = words(samples.positive)
    kinds = kinds_of(samples, vocabulary)
    found: dict[tuple[str, ...], Sum] = {}
    least = np.inf

    def look(terms: tuple[Term, ...], start: Start, steps: int) -> None:
        nonlocal least
        if time.thread_time() > until:
            return
        fit = fitted(samples, terms, start, least, steps)
        if fit is not None and fit.score < found.get(fit.kind, fit).score + 1e-12:
            found[fit.kind] = fit
            least = min(least, fit.score)

    for terms, starts in kinds:
        look(terms, starts[0], FIRST)
    near = least + GIVEN_UP
    for terms, starts in kinds:
        kind = kind_of(terms)
        if any(term.constants for term in terms) and (
            kind not in found or found[kind].score < near
        ):
            for start in starts:
                look(terms, start, STEPS)
    for one in sorted(found.values(), key=lambda one: one.score)[:SHORTENED]:
        for less in one.shorter:
            look(less.terms, less.constants, STEPS)
    return sorted(found.values(), key=lambda one: one.score)
