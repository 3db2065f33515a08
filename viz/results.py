"""The report of ``reproduce``: the study's figure, ours, the bar and the verdict, row by row."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from viz import kept
from viz.cells import NOT_MEASURED, Cell, number
from viz.figures import DRIFT_CAP, save_svg
from viz.margins import margin_figure
from viz.page import Drawn, inline_svg, read_verdicts, write_page
from viz.roles import DEVELOPMENT, first, role_of, roles
from viz.summary import one_sided_p
from viz.sweeps import sweep_figure

UNASKED = "not asked for"  # counted, and not listed
TONES = {
    "met": "good",
    "missed": "bad",
    "reported": "dull",
    "no number": "bad",
    UNASKED: "dull",
}
MISSES = ("missed", "no number")
HELD = ("met", *MISSES)  # the verdicts on what was asked for and has a bar
MARKS = "Small marks are seeds; a cross at the edge is a seed without a number."
ByTable = Mapping[str, Sequence[Mapping[str, Any]]]
ALONG_STEPS = {
    "panels": [
        {
            "metric": "energy_drift_median",
            "label": "relative energy drift, median episode",
            "coupling": None,
            "horizon": None,
            "logarithmic": True,
            "cells": "",
        }
    ],
    "along": "horizon",
    "label": "simulation steps",
    "logarithmic": True,
}
COLUMNS = ("id", "what", "the study", "ours", "over seeds", "bar", "verdict")


def write_results(run: Path) -> Path:
    """Write ``report.html`` of a run folder from ``run.json`` and ``verdicts.json``.

    Raises:
        ValueError: one of the two is missing or cannot be read.
    """
    about, tables = read_verdicts(run)
    records = _by_table(run)
    drawn: set[str] = set()
    settings = about["settings"]
    told = {
        "title": "Conservation, factoring and counterfactuals: the tables",
        "lead": _lead(tables),
        "facts": (
            f"Preset {settings['preset']}, seeds {', '.join(map(str, settings['seeds']))}, code "
            f"{about['code_version']}, started {about['created'].replace('T', ' ')}."
        ),
        "roles": [_of_role(role, tables) for role in _every_role(tables)],
        "skipped": about["skipped"],
        "tables": [_table(run, name, table, records, drawn) for name, table in tables.items()],
        "columns": COLUMNS,
        "bars": settings["bars_sha256"],
    }
    return write_page(run, "results.html", told)


def _every_role(tables: Mapping[str, Any]) -> list[str]:
    return roles([row for table in tables.values() for row in table["rows"]])


def _lead(tables: Mapping[str, Any]) -> str:
    """The result in a sentence, of the seeds that are reported."""
    rows = first([row for table in tables.values() for row in table["rows"]])
    held = Counter(row["verdict"] for row in rows if row["row"]["bar"])
    told = ", ".join(f"{held[word]} {word}" for word in HELD if held[word])
    count = sum(held[word] for word in HELD)
    return f"Of {count} figures with a bar that was registered before: {told or 'none'}."


def _of_role(role: str, tables: Mapping[str, Any]) -> dict[str, Any]:
    """What was met and missed on the seeds of one role."""
    mine = [
        (name, table, row)
        for name, table in tables.items()
        for row in table["rows"]
        if role_of(row) == role
    ]
    verdicts = Counter(row["verdict"] for _, _, row in mine).most_common()
    seeds = sorted({int(seed) for _, _, row in mine for seed in row["values"]})
    return {
        "role": role,
        "grey": role == DEVELOPMENT,
        "seeds": ", ".join(map(str, seeds)),
        "tally": [(f"{count} {verdict}", TONES[verdict]) for verdict, count in verdicts],
        "stale": sum(row.get("stale", False) for _, _, row in mine),
        "missed": [
            {"anchor": _anchor(name), "title": table["title"], "said": _said(row)}
            for name, table, row in mine
            if row["row"]["bar"] and row["verdict"] in MISSES
        ],
    }


def _said(row: Mapping[str, Any]) -> str:
    value = "no number" if row["value"] is None else number(row["value"])
    bar = f", bar {row['row']['bar']}" if row["row"]["bar"] else ""
    why = f" ({row['why']})" if row["why"] else ""
    remark = f". {row['remark']}" if row["remark"] else ""
    return f"{row['row']['what']}: {value}{bar}{why}{remark}"


def _by_table(run: Path) -> dict[str, list[dict[str, Any]]]:
    """The records of each table that left some."""
    found: dict[str, list[dict[str, Any]]] = {}
    for record in kept.rows(run / "records.parquet"):
        found.setdefault(record["experiment"], []).append(record)
    return found


def _table(
    run: Path, name: str, table: Mapping[str, Any], records: ByTable, drawn: set[str]
) -> dict[str, Any]:
    held, groups = "", []
    for role in roles(table["rows"]):
        rows = [row for row in table["rows"] if role_of(row) == role]
        counts = Counter(row["verdict"] for row in rows if row["row"]["bar"])
        told = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        seeds = f" on seeds of {role}" if role else ""
        held += f" Of the rows with a bar{seeds}: {told}." if told else ""
        shown = [_row(row) for row in rows if row["verdict"] != UNASKED]
        groups.append({"role": role, "grey": role == DEVELOPMENT, "rows": shown})
    return {
        "anchor": _anchor(name),
        "title": table["title"],
        "lead": f"{table['about']} ({table['ids']}){held}",
        "groups": groups,
        "figures": _figures(run, name, table, records, drawn),
    }


def _figures(
    run: Path, name: str, table: Mapping[str, Any], records: ByTable, drawn: set[str]
) -> list[Drawn]:
    """A table's sweeps and margins, and the drift where no table before showed these records."""
    source = table["records_of"]
    rows = first(records.get(source, []))
    captions = {
        "margins": "How far each number is from its bar, in decades.",
        "drift": f"Drift of the true energy; values above {DRIFT_CAP:g} are drawn there. {MARKS}",
    }
    found = {}
    for position, sweep in enumerate(table["sweeps"], start=1):
        found[f"sweep-{position}"] = sweep_figure(sweep, rows)
        captions[f"sweep-{position}"] = f"{sweep['caption']} {MARKS}"
    asked = [row for row in first(table["rows"]) if row["verdict"] != UNASKED]
    found["margins"] = margin_figure(asked)
    if source not in drawn:
        drawn.add(source)
        found["drift"] = sweep_figure(ALONG_STEPS, drift_along_steps(rows))
    parts = []
    for kind, figure in found.items():
        if figure is not None:
            path = run / "figures" / f"{name}-{kind}.svg"
            save_svg(figure, path)
            label = f"{table['title']}: {kind}"
            parts.append(inline_svg(path.read_text(encoding="utf-8"), label, captions[kind]))
    return parts


def drift_along_steps(records: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The drifts of cells with three horizons or more, capped for display."""
    horizons: dict[str, set[int]] = {}
    drifts = [record for record in records if record["metric"] == "energy_drift_median"]
    for record in drifts:
        horizons.setdefault(record["cell"], set()).add(record["horizon"])
    return [
        {**record, "value": record["value"] and min(DRIFT_CAP, record["value"])}
        for record in drifts
        if len(horizons[record["cell"]]) >= 3
    ]


def _row(found: Mapping[str, Any]) -> dict[str, Any]:
    row, value = found["row"], found["value"]
    ours = NOT_MEASURED if value is None else Cell(number(value), value, (row["over"],))
    marks = [(found["verdict"], TONES[found["verdict"]])]
    gone = [sum(counts) for counts in zip(*found.get("lost", {}).values(), strict=True)]
    if gone:
        marks.append((f"{gone[0]}/{gone[1]} episodes lost", "bad"))
    if found.get("stale"):
        marks.append(("stale: the code has changed since", "bad"))
    seeds = list(found["values"].values())
    matches = row["metric"].startswith("regime_match")
    spread = _matches(seeds) if matches and seeds else _spread(seeds)
    return {**found, **row, "ours": ours, "marks": marks, "spread": spread}


def _matches(values: Sequence[float]) -> str:
    """Seeds that match, with the exact one-sided binomial test against a fair coin."""
    hits, total = round(sum(values)), len(values)
    return f"{hits}/{total} seeds, p = {number(one_sided_p(hits, total))}"


def _spread(values: Sequence[float]) -> str:
    """Range of the seeds; with five or more, the normal-approximation interval of the mean."""
    if len(values) < 2:
        return ""
    if len(values) < 5:
        return f"{number(min(values))} to {number(max(values))}"
    mean = sum(values) / len(values)
    spread = (sum((v - mean) ** 2 for v in values) / (len(values) - 1)) ** 0.5
    error = 1.96 * spread / len(values) ** 0.5
    return f"mean 95 % [{number(mean - error)}, {number(mean + error)}]"


def _anchor(name: str) -> str:
    return name.replace("-", "_")
