"""How far an explanation may be believed, by the frames before the end of what is fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.verdict import EXPLAINED, NOT, Verdict

ODD = {"drive", "bath", "well"}  # kinds that are believed only where nothing plainer foretells more


@dataclass(frozen=True)
class Standing:
    """What the frames before the end say of an explanation; the others have no say in a choice.

    Args:
        status: how far it may be believed.
        verdict: on what it foretells of the last of those frames; ``None``: not known.
        error: of that; infinite where it foretells nothing.
    """

    status: str
    verdict: Verdict | None
    error: float

    @classmethod
    def of(cls, explanation: Explanation, rehearsed: bool = True) -> Standing:
        """By its rehearsal, where it has one that counts; otherwise by what it was fitted to."""
        first = next(iter(explanation.rehearsals), None) if rehearsed else None
        tail = None if first is None else first.tail
        verdict = explanation.judged(None) if first is None else first.judged(tail)
        silent = explanation.stays or (first is not None and tail is None)
        status = NOT if silent else status_of(explanation, verdict)
        error = np.inf if tail is None else tail.errors["model"]
        return cls(status, verdict, error)

    @property
    def bent(self) -> bool:
        """Whether its force is not quite the body's."""
        return self.verdict is not None and self.verdict.bent


def beside(one: Explanation, other: Explanation) -> tuple[Standing, Standing]:
    """Of two that are compared: by what both foretell, or else by what both were fitted to."""
    both = bool(one.rehearsals) and bool(other.rehearsals)
    return Standing.of(one, both), Standing.of(other, both)


def status_of(explanation: Explanation, verdict: Verdict | None) -> str:
    """By a verdict, or without one by what it was fitted to."""
    if verdict is None:
        return EXPLAINED if explanation.explained else NOT
    return verdict.status
