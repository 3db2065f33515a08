"""Figures that a table asks for in ``tables.toml``; the report draws them from the records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Panel:
    """One panel of a figure: a number of the records, a line (or a row of marks) for each model.

    Args:
        metric: of the records.
        label: of its axis, with the unit.
        coupling, horizon: only records of these; ``None``: of any.
        logarithmic: whether its axis is.
        cells: only cells that this regular expression finds; by default all.
    """

    metric: str
    label: str
    coupling: float | None = None
    horizon: int | None = None
    logarithmic: bool = True
    cells: str = ""


@dataclass(frozen=True)
class Sweep:
    """A figure of a table, drawn from its records: panels over one axis.

    Args:
        panels: share the axis.
        along: ``coupling``; ``horizon``: steps; ``cell``: the number that ends a cell's name; or
            nothing, where cells stand below each other.
        label: of the axis, with its unit.
        logarithmic: whether the axis is.
        caption: what to see.
    """

    panels: tuple[Panel, ...]
    caption: str
    along: Literal["coupling", "horizon", "cell", ""] = ""
    label: str = ""
    logarithmic: bool = False
