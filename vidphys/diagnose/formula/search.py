"""Which short sums of words fit samples of a force: a wide search, then each fitted in earnest."""

from __future__ import annotations

from collections.abc import Sequence

from vidphys.diagnose.formula.fitting import GIVEN_UP, STEPS, Guess, fitted
from vidphys.diagnose.formula.grammar import words
from vidphys.diagnose.formula.kinds import kinds_of
from vidphys.diagnose.formula.sums import Samples, Sum, kind_of

FIRST = 4  # steps of a descent at first
SHORTENED = 40  # sums that are tried without each of their words


def search(samples: Samples) -> list[Sum]:
    """Sums of one to three words, the best first, one of each kind."""
    kinds = kinds_of(samples, words(samples.positive))
    found: dict[tuple[str, ...], Sum] = {}

    def look(guesses: Sequence[Guess], steps: int) -> float:
        least = min((one.score for one in found.values()), default=float("inf"))
        for one in fitted(samples, guesses, least, steps):
            if one.score < found.get(one.kind, one).score + 1e-12:
                found[one.kind] = one
        return min((one.score for one in found.values()), default=float("inf"))

    near = look([(terms, starts[0]) for terms, starts in kinds], FIRST) + GIVEN_UP
    again = [
        (terms, start)
        for terms, starts in kinds
        for start in starts
        if any(term.constants for term in terms)
        and (kind_of(terms) not in found or found[kind_of(terms)].score < near)
    ]
    look(again, STEPS)
    best = sorted(found.values(), key=lambda one: one.score)[:SHORTENED]
    look([(less.terms, less.constants) for one in best for less in one.shorter], STEPS)
    return sorted(found.values(), key=lambda one: one.score)
