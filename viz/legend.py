"""One legend for several panels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes


def named_handles(panels: Iterable[Axes]) -> tuple[list[Artist], list[str]]:
    """Handles and labels as ``Figure.legend`` takes them: each label once, as first drawn."""
    found: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    return list(found.values()), list(found)
