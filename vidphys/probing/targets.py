"""What is asked of features: any quantity of a clip's truth, and what kind of quantity it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from vidphys.probing.truth import Truth

Kind = Literal["regression", "circular", "classification"]
Per = Literal["body", "frame", "clip"]
KINDS: tuple[Kind, ...] = get_args(Kind)
PERS: tuple[Per, ...] = get_args(Per)


@dataclass(frozen=True)
class Target:
    """One quantity.

    Args:
        name: as it stands in records.
        kind: regression; circular (angles, radians, which are told as a unit vector and scored by
            the angle between); or classification.
        per: what has a value: each body in each frame, each frame, or each clip. What is told of
            the frames of a clip is averaged where the clip has one value.
        read: of one clip's truth, ``(t, k)``: numbers (angles in radians), or for a classification
            anything that can be told apart. NaN or ``None`` where it is not known.

    Raises:
        ValueError: an unknown kind or ``per``.
    """

    name: str
    kind: Kind
    per: Per
    read: Callable[[Truth], np.ndarray]

    def __post_init__(self) -> None:
        for what, value, known in (("kind", self.kind, KINDS), ("per", self.per, PERS)):
            if value not in known:
                raise ValueError(
                    f"target {self.name}: {what} {value!r}; use one of {', '.join(known)}"
                )


@dataclass(frozen=True)
class Labels:
    """A target's values for a number of examples.

    Args:
        name, kind, per: of the target.
        values: ``(e, k)`` float64: numbers, radians, or numbers of classes; NaN where not known.
        classes: in the order of their numbers; empty where there are none.
    """

    name: str
    kind: Kind
    per: Per
    values: np.ndarray
    classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.values.ndim != 2:
            raise ValueError(
                f"target {self.name}: values must be (examples, k), got {self.values.shape}"
            )

    @property
    def known(self) -> np.ndarray:
        """Whether an example's values are known, ``(e,)``."""
        return np.isfinite(self.values).all(1)

    @property
    def why_not(self) -> str:
        """Why nothing can be learned of it; empty where something can."""
        if not self.known.any():
            return "it is known of no example"
        values = self.values[self.known]
        if self.kind == "circular":
            values = np.concatenate([np.cos(values), np.sin(values)], 1)
        return "" if np.ptp(values, 0).max() > 0 else "it is the same in all examples"


def labels_of(name: str, kind: Kind, per: Per, values: np.ndarray) -> Labels:
    """Labels from the raw values ``(e, k)`` of a target; classes are numbered in their order."""
    if kind != "classification":
        return Labels(name, kind, per, np.asarray(values, float))
    words = np.array([[_word(value) for value in row] for row in values], dtype=object)
    classes = sorted({word for row in words for word in row} - {""}, key=_in_order)
    number = {word: float(k) for k, word in enumerate(classes)} | {"": np.nan}
    return Labels(name, kind, per, np.vectorize(number.get, otypes=[float])(words), tuple(classes))


def _word(value: object) -> str:
    """A class by its name; none where it is not known."""
    if value is None or (isinstance(value, float | np.floating) and not np.isfinite(value)):
        return ""
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return str(value)


def _in_order(word: str) -> tuple[bool, float, str]:
    """Numbers by their size, then words."""
    try:
        return False, float(word), word
    except ValueError:
        return True, 0.0, word
