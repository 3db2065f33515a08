"""Runs side by side, as programs of laboratories export them, as one run below the other."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from vidphys.data.formats.names import meaning_of

RUN = r"(?:run|trial|data ?set)\s*#?\s*\d+"
BEHIND = re.compile(rf"^(?P<name>.+?)[\s,:_-]+(?P<run>{RUN})$", re.IGNORECASE)
BEFORE = re.compile(rf"^(?P<run>{RUN}|latest)\s*[:,]\s*(?P<name>.+)$", re.IGNORECASE)


def parted(name: str) -> tuple[str, str]:
    """The name of a column and the run that it is of; empty where its name says none.

    Example:
        >>> parted("Position (m) Run #2"), parted("Latest: Time (s)"), parted("x")
        (('Position (m)', 'Run #2'), ('Time (s)', 'Latest'), ('x', ''))
    """
    found = BEHIND.match(name.strip()) or BEFORE.match(name.strip())
    return (found["name"].strip(), found["run"]) if found else (name, "")


def stacked(
    table: Mapping[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """A table with one run below the other where it has them side by side, each with its times.

    PASCO's Capstone writes ``Time (s) Run #1``, Vernier's programs ``Run 1: Time (s)``. A column
    that says no run is of all of them.

    Args:
        table: columns of numbers or words, ``(rows,)``, by name.

    Returns:
        The table, with a column ``run`` where there are several; and what was done, a line each.
    """
    runs: dict[str, dict[str, np.ndarray]] = {}
    common: dict[str, np.ndarray] = {}
    for name, values in table.items():
        bare, run = parted(name)
        (runs.setdefault(run, {}) if run else common)[bare] = values
    every = [{**common, **columns} for columns in runs.values()]
    if not every or not all(_timed(columns) for columns in every):
        return dict(table), ()
    if len(every) == 1:
        return every[0], ()
    every = [_shown(columns) for columns in every]
    names = list(dict.fromkeys(name for columns in every for name in columns))
    counts = [len(next(iter(columns.values()))) for columns in every]
    out = {name: _joined([columns.get(name) for columns in every], counts) for name in names}
    out["run"] = np.repeat(np.arange(1, len(every) + 1), counts)
    return out, (f"{len(every)} runs side by side: {', '.join(runs)}",)


def _timed(columns: Mapping[str, np.ndarray]) -> bool:
    return any(meaning_of(name).kind == "time" for name in columns)


def _shown(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The rows of a run that have a time: shorter runs end in empty cells."""
    time = next(values for name, values in columns.items() if meaning_of(name).kind == "time")
    there = np.isfinite(time) if time.dtype.kind == "f" else time != ""
    return {name: values[there] for name, values in columns.items()}


def _joined(parts: list[np.ndarray | None], counts: list[int]) -> np.ndarray:
    """A column of all runs; empty in those that do not have it."""
    words = any(part is not None and part.dtype.kind in "USO" for part in parts)
    empty = "" if words else np.nan
    whole = (
        np.full(count, empty) if part is None else part
        for part, count in zip(parts, counts, strict=True)
    )
    return np.concatenate([part.astype(str) if words else part for part in whole])
