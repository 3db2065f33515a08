"""The report of ``trade``: what was measured on this machine, and what no other point beats."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz import kept
from viz.cells import number
from viz.figures import save_svg
from viz.page import inline_svg, write_page
from viz.trade_figures import Row, crowd_figure, pareto_figure, work_precision_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BY = {  # the settings of a front that its points are told apart by
    "learned": ("evaluation",),
    "drawing": ("memory",),
    "encoders": ("encoder",),
    "runtimes": ("runtime", "dtype", "batch", "store_dtype", "grid"),
    "readouts": ("readout",),
    "training": ("trajectories",),
    "pipeline": ("readout",),
}
COLUMNS = ("task", "setting", "cost", "quartiles", "error", "first call", "memory", "units")


def write_trade(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder from its measured points.

    Raises:
        ValueError: the run's files are missing or cannot be read.
    """
    try:
        about = kept.words(run / "run.json")
        rows = _rows(run)
    except ValueError as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    fronts = list(dict.fromkeys(row["front"] for row in rows))
    settings = about["settings"]
    told = {
        "title": "Speed against accuracy, on this machine",
        "lead": _lead(rows, fronts),
        "facts": f"Preset {settings['preset']}; "
        + ", ".join(f"{k} {v}" for k, v in settings["surroundings"].items())
        + ".",
        "skipped": about["skipped"],
        "fronts": [_front(run, [row for row in rows if row["front"] == name]) for name in fronts],
        "columns": COLUMNS,
    }
    return write_page(run, "trade.html", told)


def _lead(rows: Sequence[Row], fronts: Sequence[str]) -> str:
    """The result in a sentence: how much a best point may cost more than another of its task."""
    tasks: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["error"] is not None and row["best"]:
            tasks.setdefault((row["front"], row["task"]), []).append(row)
    spans = {
        key: max(row["cost"] for row in best) / min(row["cost"] for row in best)
        for key, best in tasks.items()
        if min(row["cost"] for row in best) > 0
    }
    kept = sum(len(best) for best in tasks.values())
    kinds = "one kind" if len(fronts) == 1 else f"{len(fronts)} kinds"
    text = (
        f"{len(rows)} points of {kinds} of work were measured; no other is both "
        f"cheaper and more accurate than {kept} of them."
    )
    if not spans:
        return text
    (front, task), most = max(spans.items(), key=lambda item: item[1])
    return text + (
        f" Accuracy costs most in {front} ({task}): a factor of {number(most)} between the "
        "cheapest and the most accurate of these."
    )


def _rows(run: Path) -> list[dict[str, Any]]:
    profile = kept.words(run / "profile.json")
    best = {_key(point) for point in profile["points"]}
    rows = kept.rows(run / "points.parquet")
    for row in rows:
        for name in ("configuration", "units", "errors"):
            row[name] = json.loads(row[name])
        row["best"] = _key(row) in best
    return rows


def _key(row: Row) -> str:
    return json.dumps([row["front"], row["task"], row["configuration"]], sort_keys=True)


def _front(run: Path, rows: Sequence[Row]) -> dict[str, Any]:
    name = rows[0]["front"]
    path = run / "figures" / f"{name}.svg"
    save_svg(_figure(name, rows), path)
    caption = f"Error: {rows[0]['reference']}."
    return {
        "id": name,
        "title": name.capitalize(),
        "figure": inline_svg(path.read_text(encoding="utf-8"), name, caption),
        "rows": list(map(_line, rows)),
    }


def _figure(name: str, rows: Sequence[Row]) -> Figure:
    if name == "rollouts":
        return work_precision_figure(rows)
    if name == "forces":
        return crowd_figure(rows)
    return pareto_figure(rows, BY[name])


def _line(row: Row) -> dict[str, Any]:
    told = ", ".join(f"{k} {v}" for k, v in row["configuration"].items() if v is not None)
    error = "not finite" if row["error"] is None else number(row["error"])
    memory = "" if row["peak_bytes"] is None else f"{row['peak_bytes'] / 2**20:.1f} MiB"
    units = ", ".join(f"{_counted(v)} {k.replace('_', ' ')}" for k, v in row["units"].items())
    others = "".join(f", {number(v)} {k}" for k, v in row["errors"].items())
    cells = (
        f"{number(row['cost'])} {row['cost_name']}",
        f"{number(row['cost_low'])} to {number(row['cost_high'])} ({row['clock']})",
        f"{error} {row['error_name']}{others}",
        f"{number(row['warmup_seconds'])} s",
        memory,
        units,
    )
    return {"task": row["task"], "told": told, "best": row["best"], "cells": cells}


def _counted(value: float) -> str:
    return f"{value:,.0f}" if value >= 1e4 else number(value)
