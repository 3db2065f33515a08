"""What every explanation of a motion offers: words, numbers, forecasts, and its scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self

import numpy as np

from vidphys.diagnose.explanations.forecast import Validation
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY, NOT, Verdict
from vidphys.diagnose.recordings.noise import Noise
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.weak.spectrum import Mode


@dataclass(frozen=True)
class Oscillation:
    """One oscillation of a scene.

    Args:
        small: of the model about its rest, by its linearisation.
        model: of the model rolled over the recording.
        seen: of the recording, by its spectrum alone.
    """

    small: Mode
    model: Mode
    seen: Mode


class Explanation(Protocol):
    """An explanation of one recording, whose tail after a frame ``end`` nothing was fitted to.

    A class that derives from it says what it has; the rest is nothing.
    """

    @property
    def kinds(self) -> list[str]:
        """Of the terms that the scene has, sorted."""

    @property
    def explained(self) -> bool:
        """Whether nothing above the noise is left over."""
        return self.verdict is None or self.verdict.status == EXPLAINED

    @cached_property
    def verdict(self) -> Verdict | None:
        """How far it may be trusted; ``None`` where that is not known."""
        judged = self.judged(self.tail)
        if judged is None or not self.stays:
            return judged
        return replace(judged, status=NOT if judged.status == NOT else MOSTLY, stays=True)

    @property
    def sure(self) -> bool:
        """Whether it explains all, and nothing else does nearly as well."""
        return self.explained

    @property
    def one_law(self) -> bool:
        """Whether all bodies move by one law, so that there is nothing between them to ask for."""
        return False

    @property
    def each_by_a_place(self) -> bool:
        """Whether each of several bodies has an unseen place of its own that pulls or pushes it.

        The others may be what does so: two that circle each other go as if about a place, and keep
        the balance of their masses.
        """
        return False

    @property
    def first(self) -> int:
        """First frame that it says something of; a hand may have held a body before."""
        return 0

    @property
    def told_in(self) -> Units | None:
        """Units of its own, where it knows better ones."""
        return None

    @property
    def noise(self) -> Noise | None:
        """Of the positions, as it leaves it; ``None`` where it tells nothing of that."""
        return None

    @property
    def fastest(self) -> float:
        """Rate of the stiffest motion that occurred, radians per second; 0 where nothing swings."""

    @property
    def follows(self) -> float | None:
        """Seconds for which it follows the recording at a time; ``None``: for all of it."""
        return None

    def lines(self) -> list[str]:
        """For a person, a sentence each."""

    def data(self) -> dict[str, Any]:
        """Its own entries of ``diagnosis.json``."""
        return {}

    def numbers(self) -> dict[str, float]:
        """Its own entries of the records, by metric."""
        return {}

    def path(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times and positions ``(t, n, d)`` over the last clip; ``None`` where it has no path."""
        return None

    def rolled_on(self) -> Validation | None:
        """Its law in the tail, beside simple forecasts; ``None`` where it cannot be rolled on."""

    @cached_property
    def tail(self) -> Validation | None:
        """As :meth:`rolled_on`, which rolls: once."""
        return self.rolled_on()

    def judged(self, tail: Validation | None) -> Verdict | None:
        """How far it may be trusted, by what it foretells of a tail; ``None``: not known."""
        return None

    def earlier(self) -> Sequence[Self]:
        """The same law by ever more of its frames, whose tail is the others; none: not known."""
        return ()

    @cached_property
    def rehearsals(self) -> Sequence[Self]:
        """As :meth:`earlier`, which fits: once, and where there is a tail that it foretells."""
        return () if self.tail is None else self.earlier()

    @cached_property
    def stays(self) -> bool:
        """Whether that the bodies stay where they are is as good a forecast as its law.

        Frames that were held out have no say in it: the law is rolled on over the last ones that
        it was fitted to, with its numbers from those before.
        """
        return not all(each.foretells for each in self.rehearsals)

    @property
    def foretells(self) -> bool:
        """Whether its law is believed by what it says of the tail, or gains on staying."""
        tail = self.tail
        if tail is not None and not np.isfinite(tail.seen).any():
            return True  # nothing was seen there that would speak against it
        judged = self.judged(tail)
        believed = judged is not None and judged.status != NOT
        return believed or (tail is not None and tail.gains)

    def forecast(self) -> Validation | None:
        """What is foretold of the tail, beside simple forecasts."""
        return self.tail.at_rest if self.tail and self.stays else self.tail

    def oscillations(self) -> list[Oscillation]:
        """The model's beside the recording's own, slowest first."""
        return []

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Times and positions ``(t, n, d)`` after ``end`` under laws that were never recorded."""

    def specification(self) -> dict[str, Any] | None:
        """The scene; see :func:`vidphys.diagnose.explanations.specification.as_specification`.

        ``None`` where no term of a model carries it.
        """
