"""Cells and pixels: how the grid of some features lies on the frames that they are of."""

from __future__ import annotations

from collections.abc import Sequence

Size = tuple[int | float, int | float]


class Bordered(tuple[float, float]):
    """Size of frames, (height, width), of which a grid leaves out a border.

    Args:
        size: of the whole frames, pixels.
        border: pixels that are left out above, and as many below; left, and as many right.
    """

    border: tuple[float, float]

    def __new__(cls, size: Size, border: Size = (0.0, 0.0)) -> Bordered:
        made = super().__new__(cls, size)
        made.border = (float(border[0]), float(border[1]))
        return made


def stride_of(size: Size, shape: Sequence[int]) -> tuple[float, ...]:
    """Pixels between the cells of ``(…, h, w)`` on frames of a size (height, width).

    A border that the grid leaves out follows: its pixels above and left.

    Example:
        >>> stride_of((32, 64), (4, 4)), stride_of(Bordered((32, 64), (0, 16)), (4, 4))
        ((8.0, 16.0), (8.0, 8.0, 0.0, 16.0))
    """
    border = size.border if isinstance(size, Bordered) else (0.0, 0.0)
    cells = zip(size, border, shape[-2:], strict=True)
    plain = tuple((side - 2 * out) / count for side, out, count in cells)
    return plain + border if any(border) else plain


def size_of(stride: Sequence[float], shape: Sequence[int]) -> tuple[float, float]:
    """Size of the frames, (height, width), under ``(…, h, w)`` cells; see :func:`stride_of`."""
    down, across, *border = stride
    above, left = border or (0.0, 0.0)
    size = down * shape[-2] + 2 * above, across * shape[-1] + 2 * left
    return Bordered(size, (above, left)) if border else size
