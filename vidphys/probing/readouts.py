"""Readouts of any target from feature frames, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from vidphys.probing.controls import POOLED
from vidphys.probing.folds import CrossValidation, Predictions
from vidphys.probing.forms import CELLS, FORMS, SOFTMAX, at_places
from vidphys.probing.linear import Seen, read_linearly, seen_as

LINEAR, LOCAL, ATTENTION, TWO_STAGE = "linear", "local", "attention", "two-stage"
READOUTS = {
    LINEAR: "a ridge regression on that form of the map which does best on clips left out",
    CELLS: "a ridge regression on all cells of the map",
    POOLED: "a ridge regression on the mean over all cells",
    SOFTMAX: "a ridge regression on where each channel speaks",
    TWO_STAGE: "positions by `linear`, then a ridge regression on the motion of their track",
    ATTENTION: "queries that attend over the cells, trained; minutes a layer",
    LOCAL: "a ridge regression on the features at each body's true place",
}


class Readout(Protocol):
    """Maps to predictions of several targets, each clip by what did not see it."""

    def __call__(self, maps: Tensor, asked: CrossValidation) -> list[Predictions]:
        """Of the maps ``(e, c, h, w)`` of examples, what is said of each question."""
        ...


@dataclass(frozen=True)
class Linear(Readout):
    """A ridge regression on forms of the map; each target takes the one that does best.

    Args:
        forms: of :data:`FORMS`.
    """

    forms: tuple[str, ...] = tuple(FORMS)

    def __call__(self, maps: Tensor, asked: CrossValidation) -> list[Predictions]:
        return read_linearly(seen_forms(maps, self.forms), asked)


def seen_forms(maps: Tensor, forms: Sequence[str] = tuple(FORMS)) -> dict[str, Seen]:
    """Maps in several forms; one cell has but one."""
    names = (POOLED,) if maps.shape[-2:] == (1, 1) else forms
    return {name: seen_as(FORMS[name](maps)) for name in names}


@dataclass(frozen=True)
class Local(Readout):
    """A ridge regression on what lies at the bodies' places, one for all bodies.

    What is told of a body is read from its place alone, by the same weights for all. A target that
    has not a value for each body is read from all places side by side.

    Args:
        places: of each body in each example, ``(e, n, 2)``, see :func:`at_places`.
    """

    places: Tensor

    def __call__(self, maps: Tensor, asked: CrossValidation) -> list[Predictions]:
        maps, bodies = at_places(maps, self.places), self.places.shape[1]
        found: dict[int, Predictions] = {}
        for count in {1, bodies}:
            mine = [
                k
                for k, question in enumerate(asked.questions)
                if _bodies(question.values.shape[1], bodies) == count
            ]
            if mine:
                seen = seen_as(_by_body(maps) if count > 1 else maps)
                said = read_linearly({LOCAL: seen}, asked.only(mine).body_by_body(count))
                for k, each in zip(mine, said, strict=True):
                    found[k] = each.shaped(asked.questions[k].values.shape)
        return [found[k] for k in range(len(asked.questions))]


def _bodies(columns: int, bodies: int) -> int:
    """How many bodies have columns of their own."""
    return bodies if columns % bodies == 0 else 1


def _by_body(maps: Tensor) -> Tensor:
    """``(e, c, n, 1)`` with each body as an example, ``(e * n, c, 1, 1)``."""
    return maps.movedim(2, 1).flatten(0, 1)[..., None]
