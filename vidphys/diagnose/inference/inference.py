"""What was found of a motion: which terms, their numbers, and how sure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from vidphys.diagnose.inference.menu import FRICTION, Term
from vidphys.diagnose.inference.refine import Fitted
from vidphys.diagnose.inference.residual import CERTAIN, Leftover, friction_rate
from vidphys.diagnose.inference.structures import Structure, chance, price
from vidphys.diagnose.recordings.noise import Noise
from vidphys.diagnose.weak.windows import Windows
from vidphys.statistics import NORMAL_95

LENIENT = 0.75  # of the price of a number, given back to rivals
BY_CHANCE = 1e-3  # that a term gains as much where it is not there, below which it may be there
UNSURE = 0.9  # probability of a structure under which the diagnosis says that it is not sure


@dataclass(frozen=True)
class Inference:
    """Which terms, and how sure.

    Args:
        fitted: the best structure with its numbers, their errors and the model's paths.
        windows: the final ones.
        noise: of the positions.
        probability: of each set of kinds.
        kicks: variance of random kicks per second, ``(world units / s)^2 / s``; 0 if there
            are none.
        kicks_gain: of log likelihood, by the kicks.
        leftover: what is not explained.
        structures: all that were tried, best first.
        alone: kinds for which one stretch of the recording alone speaks.
        between: whether a pair force by a power between whole ones is as likely, without the rest.
    """

    fitted: Fitted
    windows: Windows
    noise: Noise
    probability: dict[frozenset[str], float]
    kicks: float
    kicks_gain: float
    leftover: Leftover
    structures: tuple[Structure, ...]
    alone: frozenset[str] = frozenset()
    between: bool = False

    @property
    def structure(self) -> Structure:
        """The best structure."""
        return self.fitted.structure

    @property
    def idle(self) -> bool:
        """Whether a friction beside random kicks may be zero.

        Kicks are tried with a friction that balances them: nothing else speaks for it then.
        """
        rate, error = friction_rate(self.fitted)
        return self.kicks > 0 and abs(rate) <= NORMAL_95 * error

    @property
    def without_kicks(self) -> bool:
        """Whether nothing is left unexplained, and no random kicks are needed for it."""
        return self.leftover.explained and not self.kicks

    @property
    def bathed(self) -> bool:
        """Whether there are random kicks, and a friction that surely takes what they give."""
        return self.kicks > 0 and not self.idle and friction_rate(self.fitted)[0] > 0

    @property
    def terms(self) -> tuple[Term, ...]:
        """Those of the best structure, without a friction that may be zero beside kicks."""
        return tuple(t for t in self.structure.terms if not (self.idle and t.family == FRICTION))

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of the terms, the bath among them."""
        if self.idle:
            return frozenset(kind for term in self.terms for kind in term.kinds)
        return self.structure.kinds | ({"bath"} if self.bathed else frozenset())

    @property
    def sure(self) -> bool:
        """Whether the answer stands, and nothing says that it may do so by accident."""
        doubted = self.smoothly or self.alone or self.slight or self.leftover.unseen or self.between
        return self.stands and not doubted

    @property
    def stands(self) -> bool:
        """Whether the alternatives are unlikely and nothing is left unexplained, anywhere."""
        likely = self.probability.get(self.structure.kinds, 0.0) >= UNSURE
        return likely and self.leftover.explained and self.leftover.even and not self.rivalled

    @property
    def smoothly(self) -> bool:
        """Whether a force that changes smoothly explains about as much as the random kicks."""
        rest = self.leftover
        return self.bathed and rest.kicks_gain - rest.smooth_gain < CERTAIN

    @property
    def rivalled(self) -> bool:
        """Whether other terms fit better and lose by the price of their numbers alone.

        Terms beside the winner's are no rivals: of such see ``slight``.
        """
        best = self.structures[0]
        given_back = LENIENT * 0.5 * np.log(max(self.fitted.freedom, 2))

        def worth(structure: Structure) -> float:
            return structure.score + given_back * structure.numbers

        return any(worth(s) > worth(best) for s in self.structures if not s.kinds >= best.kinds)

    @property
    def slight(self) -> frozenset[str]:
        """Kinds beside the winner's that explain more than chance, and less than they cost."""
        best, rows = self.structures[0], max(self.fitted.freedom, 2)
        found: set[str] = set()
        for other in self.structures:
            numbers = other.numbers - best.numbers
            if other.kinds > best.kinds and numbers > 0:
                gain = other.score - best.score + price(rows, numbers)
                if chdtrc(numbers, 2 * max(gain, 0.0)) < BY_CHANCE:
                    found |= other.kinds - best.kinds
        return frozenset(found)

    def chance(self, kind: str) -> float:
        """Probability that a kind of term is there."""
        return chance(self.probability, kind)
