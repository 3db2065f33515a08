"""Which seeds each cell of a run was asked for: without it a lost one would not be missed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

ASKED = "asked"  # in a run's settings: the seeds of each cell


def asked_of(settings: Mapping[str, Any]) -> dict[str, list[int]]:
    """The seeds that each cell of a run was asked for; every seed where a run does not say it."""
    known = settings.get(ASKED)
    return {cell: settings["seeds"] for cell in settings["cells"]} if known is None else known


def with_asked(
    before: Mapping[str, Sequence[int]], now: Mapping[str, Sequence[int]]
) -> dict[str, list[int]]:
    """What was asked for at first, and what is asked for on top of it."""
    cells = sorted({*before, *now})
    return {cell: sorted({*before.get(cell, ()), *now.get(cell, ())}) for cell in cells}
