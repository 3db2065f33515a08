"""What is said of the powers of the coupling, and what to measure where several are left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from dynamics.powers import COUPLINGS

CANDIDATES = ("linear", "even", "quadratic", "cubic")
LIMIT = 4.0  # standard deviations by which a candidate must be worse to be ruled out
UNEXPLAINED = 0.5  # share of the force above which no candidate counts as an explanation
QUERIES = (-1.0, -0.5, 2.0, -2.0)  # over the median coupling that was seen, cheapest first
APART = 0.2  # of the force at the median coupling, by which a query must part two candidates
SUPPORTED, UNDECIDED, CONTRADICTED, UNEXPLAINED_LAW = (
    "supported",
    "undecided",
    "contradicted",
    "unexplained",
)


@dataclass(frozen=True)
class PowerVerdict:
    """What the data say.

    Args:
        supported: candidates that explain the data equally well; none where no candidate does.
        unexplained: share of the held-out force that each candidate leaves, 0 to about 1.
        query: the coupling to measure next, where more than one candidate is left and one
            measurement parts them all.
        why: one sentence.
    """

    supported: tuple[str, ...]
    unexplained: dict[str, float]
    query: float | None
    why: str

    def of(self, assumed: str) -> str:
        """Standing of the power that a model assumes.

        Returns:
            ``supported`` (by itself), ``undecided``, ``contradicted`` or ``unexplained``. Anything
            but the first is a warning not to trust a counterfactual of the coupling.
        """
        if not self.supported:
            return UNEXPLAINED_LAW
        if assumed not in self.supported:
            return CONTRADICTED
        return SUPPORTED if len(self.supported) == 1 else UNDECIDED


def deciding_query(candidates: Sequence[str], seen: float) -> float | None:
    """The nearest coupling at which all candidates, equal at ``seen``, say different things.

    Raises:
        ValueError: ``seen`` is zero, where all candidates agree that there is no force.
    """
    if seen == 0:
        raise ValueError("deciding_query: the coupling that was seen must not be zero")
    for factor in QUERIES:
        said = sorted(COUPLINGS[c](factor) for c in candidates)  # over what it is at ``seen``
        if all(after - before >= APART for before, after in pairwise(said)):
            return factor * seen
    return None
