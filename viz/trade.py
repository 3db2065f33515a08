"""The report of ``trade``: what was measured on this machine, and what no other point beats."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from viz.cells import number
from viz.figures import save_svg
from viz.page import heading, inline_svg, paragraph, section, write_page
from viz.trade_figures import Row, crowd_figure, pareto_figure, work_precision_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BY = {
    "learned": "evaluation",
    "drawing": "memory",
    "encoders": "encoder",
    "runtimes": "runtime",
    "readouts": "readout",
    "training": "trajectories",
    "pipeline": "readout",
}
COLUMNS = ("task", "setting", "cost", "quartiles", "error", "first call", "memory", "units")


def write_trade(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder from its measured points.

    Raises:
        ValueError: the run's files are missing or cannot be read.
    """
    try:
        about = json.loads((run / "run.json").read_text(encoding="utf-8"))
        rows = _rows(run)
    except (OSError, ValueError) as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    fronts = list(dict.fromkeys(row["front"] for row in rows))
    parts = [_front(run, [row for row in rows if row["front"] == name]) for name in fronts]
    sections = [_short(about), *parts]
    lead = (
        "Points of a task were timed in turn; a cost is the median, after a "
        "call that does not count. Bold: no other point of the task is both cheaper and more "
        "accurate."
    )
    head = heading("Speed against accuracy, on this machine", lead)
    return write_page(run, "Trade", head, sections)


def _rows(run: Path) -> list[dict[str, Any]]:
    import pyarrow.parquet as pq

    profile = json.loads((run / "profile.json").read_text(encoding="utf-8"))
    best = {_key(point) for point in profile["points"]}
    rows = pq.read_table(run / "points.parquet").to_pylist()
    for row in rows:
        for name in ("configuration", "units", "errors"):
            row[name] = json.loads(row[name])
        row["best"] = _key(row) in best
    return rows


def _key(row: Row) -> str:
    return json.dumps([row["front"], row["task"], row["configuration"]], sort_keys=True)


def _short(about: dict[str, Any]) -> str:
    facts = ", ".join(f"{k} {v}" for k, v in about["settings"]["surroundings"].items())
    parts = [paragraph(f"Preset {about['settings']['preset']}; {facts}.")]
    skipped = [f"<li>{escape(s['cell'])}: {escape(s['reason'])}</li>" for s in about["skipped"]]
    if skipped:
        parts.append(f'<div class="callout"><p>Not measured:</p><ul>{"".join(skipped)}</ul></div>')
    return section("short", "In short", *parts)


def _front(run: Path, rows: Sequence[Row]) -> str:
    name = rows[0]["front"]
    path = run / "figures" / f"{name}.svg"
    save_svg(_figure(name, rows), path)
    drawing = inline_svg(path.read_text(encoding="utf-8"), name, f"Error: {rows[0]['reference']}.")
    head = "".join(f'<th scope="col">{column}</th>' for column in COLUMNS)
    table = f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
    return section(
        name, name.capitalize(), drawing, table + "".join(map(_line, rows)) + "</table></div>"
    )


def _figure(name: str, rows: Sequence[Row]) -> Figure:
    if name == "rollouts":
        return work_precision_figure(rows)
    if name == "forces":
        return crowd_figure(rows)
    return pareto_figure(rows, BY[name])


def _line(row: Row) -> str:
    told = ", ".join(f"{k} {v}" for k, v in row["configuration"].items() if v is not None)
    told = f"<b>{escape(told)}</b>" if row["best"] else escape(told)
    error = "not finite" if row["error"] is None else number(row["error"])
    memory = "" if row["peak_bytes"] is None else f"{row['peak_bytes'] / 2**20:.1f} MiB"
    units = ", ".join(f"{number(v)} {k.replace('_', ' ')}" for k, v in row["units"].items())
    cells = (
        f"{number(row['cost'])} {row['cost_name']}",
        f"{number(row['cost_low'])} to {number(row['cost_high'])} ({row['clock']})",
        f"{error} {row['error_name']}",
        f"{number(row['warmup_seconds'])} s",
        memory,
        units,
    )
    numbers = "".join(f'<td class="num">{escape(cell)}</td>' for cell in cells)
    return f"<tr><td>{escape(row['task'])}</td><td>{told}</td>{numbers}</tr>"
