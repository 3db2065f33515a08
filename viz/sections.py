"""The parts of a ladder's report that fold: figures and tables of everything that was measured.

Each function gives a part for the template, ``None`` where the run has nothing of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from viz import figures, tables
from viz.cells import number
from viz.explain import what_spread_means
from viz.overlay import contact_sheet
from viz.page import Drawn, inline_png, inline_svg
from viz.roles import looked_at
from viz.sentences import law
from viz.showcase import read_showcase
from viz.summary import TWIN, Records

SHEET_BYTES = 400_000  # of pictures that the page holds; all of them lie in figures/
SHEET_HEADS = ("factored", TWIN)  # whose showcases are drawn in the report


def ladder(run: Path, records: Records, references: Mapping[str, float]) -> dict[str, Any] | None:
    """Errors under the flipped law, of every head and reading."""
    if not records.couplings:
        return None
    picture = _drawn(
        run,
        "ladder",
        figures.ladder_figure(records, references),
        "Error under the flipped coupling by rung and head",
        "Large mark: mean over seeds; small marks: seeds. Left is better. A mark left of the "
        "dashed line answers the changed law: it has less than half of the error without any "
        "force. One right of the dotted line is worse than assuming that no force acts at all.",
    )
    return {
        "id": "ladder",
        "title": "The ladder, every head and reading",
        "texts": [what_spread_means(records)],
        "figure": picture,
        "table": tables.ladder_table(records),
    }


def force(run: Path, records: Records) -> dict[str, Any] | None:
    """How far each head's force points as the true one does."""
    if "force_cosine" not in records.metrics:
        return None
    picture = _drawn(
        run,
        "force_cosine",
        figures.force_figure(records),
        "Force cosine by rung and head",
        "Large mark: mean over seeds; small marks: seeds. A head far from 1 does not know the "
        "force, whatever its error over a short rollout says.",
    )
    return {"id": "force", "title": "Which force was learned", "figure": picture}


def couplings(records: Records, episodes: Records | None) -> dict[str, Any] | None:
    """Errors at every coupling that was asked."""
    if not records.couplings:
        return None
    apart = []
    for g in records.couplings:
        found = [records.pick(line, "truth_distance", coupling=g) for line in records.lines]
        values = [value for one in found if one for value in one.values]
        if values:
            apart.append(f"{number(sum(values) / len(values))} at {law(g)}")
    text = (
        f"The two truths, changed law and old law, are themselves apart by an nMSE of "
        f"{', '.join(apart)} (mean over all rows): an error near that says that the change was "
        "missed."
    )
    return {
        "id": "couplings",
        "title": "All couplings",
        "texts": [text] if apart else [],
        "table": tables.couplings_table(records, episodes),
    }


def drift(run: Path, records: Records) -> dict[str, Any] | None:
    """Energy drift over the steps."""
    if not records.horizons:
        return None
    picture = _drawn(
        run,
        "drift",
        figures.drift_figure(records),
        "Energy drift against simulation steps by rung and head",
        "Line: median episode; band: up to the worst episode of any seed. At the dotted line the "
        f"error is as large as the energy itself. Drifts above {figures.DRIFT_CAP:,.0f} are drawn "
        "there.",
    )
    table = tables.drift_table(records)
    return {"id": "drift", "title": "Does the energy hold", "figure": picture, "table": table}


def tabled(
    name: str, title: str, table: tables.Table | None, text: str = ""
) -> dict[str, Any] | None:
    """A part that is a table."""
    if table is None:
        return None
    return {"id": name, "title": title, "texts": [text] if text else [], "table": table}


def sheets(run: Path, records: Records) -> dict[str, Any] | None:
    """The showcase episodes of the factored heads and of their twins."""
    sheets: list[tuple[str, Drawn]] = []
    taken = left = 0
    cells = [f"{x.grounding}/{x.head}" for x in records.lines if x.head in SHEET_HEADS]
    for cell in dict.fromkeys(cells):
        stem = cell.replace("/", "-")
        file = run / "showcase" / f"{stem}.safetensors"
        if not file.is_file():
            continue
        path = run / "figures" / f"showcase-{stem}.png"
        showcase, meta = read_showcase(file)
        figures.save_png(contact_sheet(showcase, {"cell": cell, **meta}), path, dots_per_inch=90)
        picture = path.read_bytes()
        taken += len(picture)
        if sheets and taken > SHEET_BYTES:
            left += 1
        else:
            sheets.append((cell, inline_png(picture, f"One episode of {cell}")))
    text = (
        "One test episode of each cell: what was observed, then both laws rolled forward. "
        "The command vidphys view shows it in time."
    )
    if left:
        text += f" {left} more lie in figures/, so that this page stays small."
    if not sheets:
        return None
    return {"id": "episodes", "title": "One episode, seen", "texts": [text], "sheets": sheets}


def development(older: Records | None) -> dict[str, Any] | None:
    """The ladder on the seeds that were looked at while tuning, greyed."""
    if older is None or not older.couplings:
        return None
    return {
        "id": "development",
        "title": "Development seeds",
        "texts": [looked_at(older)],
        "table": tables.ladder_table(older),
        "grey": True,
    }


def _drawn(run: Path, name: str, figure: Any, label: str, caption: str) -> Drawn:
    """Keep a figure in ``figures/`` as vectors and pixels, and return it for the page."""
    path = run / "figures" / f"{name}.svg"
    figures.save_svg(figure, path)
    figures.save_png(figure, path.with_suffix(".png"))
    return inline_svg(path.read_text(encoding="utf-8"), label, caption)
