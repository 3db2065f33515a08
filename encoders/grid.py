"""Cells and pixels: how the grid of some features lies on the frames that they are of."""

from __future__ import annotations

from collections.abc import Sequence


def stride_of(size: tuple[int | float, int | float], shape: Sequence[int]) -> tuple[float, float]:
    """Pixels between the cells of ``(…, h, w)`` on frames of a size (height, width)."""
    return size[0] / shape[-2], size[1] / shape[-1]


def size_of(stride: tuple[float, float], shape: Sequence[int]) -> tuple[float, float]:
    """Pixels of the frames, (height, width), under ``(…, h, w)`` cells."""
    return stride[0] * shape[-2], stride[1] * shape[-1]
