"""How a target stands in numbers that a readout gives, and what such numbers say of it.

A number is itself; an angle is a unit vector, so that a turn has no seam; a class is a place among
all classes, of which the largest number is meant.
"""

from __future__ import annotations

import numpy as np

from vidphys.probing.targets import Labels


def coded(labels: Labels) -> np.ndarray:
    """``(e, k, m)``: m is 1 for numbers, 2 for angles, else the number of classes.

    Example:
        >>> labels = Labels("way", "circular", "frame", np.array([[0.0], [np.pi / 2]]))
        >>> coded(labels).round(2).tolist()
        [[[1.0, 0.0]], [[0.0, 1.0]]]
    """
    values = labels.values
    if labels.kind == "circular":
        return np.stack([np.cos(values), np.sin(values)], -1)
    if labels.kind == "classification":
        return (values[..., None] == np.arange(len(labels.classes))).astype(float)
    return values[..., None]


def decoded(labels: Labels, raw: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """``(e, k)`` in the unit of the labels, from ``raw (e, k, m)``.

    Of classes it is the one whose probability rose most above its share of what taught, which is
    best where every class counts alike.

    Args:
        labels: of which kind.
        raw: what was said.
        constant: what is said without looking.
    """
    if labels.kind == "circular":
        return np.arctan2(raw[..., 1], raw[..., 0])
    if labels.kind == "classification":
        risen = np.full(raw.shape, -np.inf)
        return np.divide(raw, constant, out=risen, where=constant > 0).argmax(-1).astype(float)
    return raw[..., 0]
