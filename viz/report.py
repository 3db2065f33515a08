"""The report of a run folder: one HTML file that opens offline and says what the records say."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from viz import facts, figures, kept, sections, tables
from viz.cells import NOT_MEASURED, Cell, chosen_cell, mean_cell, number
from viz.explain import how_to_read, what_spread_means
from viz.headline import headline
from viz.moving import moving_pair
from viz.page import write_page
from viz.paths import typed
from viz.roles import by_role
from viz.sentences import asked, fails, holds, law
from viz.summary import TWIN, Line, Records, median


def write_report(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder.

    Args:
        run: a folder with ``run.json`` and ``records.parquet``; ``episodes.parquet`` and
            ``showcase/*.safetensors`` are used where they are.

    Raises:
        ValueError: the folder, or one of the two files, is missing or cannot be read.
    """
    about, every, raw = read_run(run)
    records, older = by_role(every)
    episodes = by_role(raw)[0] if raw else None
    settings = about.get("settings") or {}
    experiment = str(
        about.get("experiment") or settings.get("experiment") or records.rows[0].get("experiment")
    )
    ladder = bool(records.couplings)
    references = settings.get("tables", {}).get("ladder", {}).get("references") or {}
    parts = [
        sections.ladder(run, records, references),
        {"id": "read", "title": "How to read this", "texts": how_to_read()},
        sections.force(run, records),
        sections.couplings(records, episodes),
        sections.drift(run, records),
        sections.tabled(
            "perception", "What was perceived", tables.perception_table(records), PERCEIVED
        ),
        sections.tabled("others", "Other numbers", tables.other_table(records)),
        sections.sheets(run, records),
        sections.development(older),
    ]
    told = {
        "title": "The grounding ladder" if experiment == "ladder" else experiment,
        "sentences": _sentences(records, about) if ladder else [],
        "headline": headline(records, references) if ladder else None,
        "play": read_play(run) if ladder else None,
        "moving": moving_pair(run, records) if ladder else None,
        "first": _first(run, about, records, references, raw) if ladder else [],
        "error": f"error at {law(records.coupling)}",
        "drift": "energy drift" if records.horizon is None else f"drift, {records.horizon:,} steps",
        "spread": what_spread_means(records),
        "tally": facts.tally(records),
        "facts": facts.of_run(about, every),
        "missing": facts.missing(about, records),
        "negative": facts.negative(records) if ladder else None,
        "verdicts": tables.verdict_table(records) if ladder else None,
        "parts": [{**EMPTY, **part} for part in parts if part],
        "kept": facts.kept(every),
        "settings": facts.settings(about),
        "episodes": _episodes(raw) if raw else {},
    }
    return write_page(run, "ladder.html", told)


EMPTY: dict[str, Any] = {"texts": [], "figure": None, "table": None, "grey": False, "sheets": []}
PERCEIVED = (
    "Errors of the perceived state at t = 0, before anything was rolled forward. Under shooting, a "
    "head whose own start states foretell worse than the differences do starts from these."
)


def read_run(run: Path) -> tuple[dict[str, Any], Records, Records | None]:
    """``run.json``, the records, and the per-episode inversion errors if there are any."""
    for name in ("run.json", "records.parquet"):
        if not (run / name).is_file():
            begun = name != "run.json" and (run / "run.json").is_file()
            what = "its command again, no cell is finished" if begun else "the folder of a ladder"
            raise ValueError(f"report: {run / name} is missing; give {what}")
    raw = run / "episodes.parquet"
    try:
        about = kept.words(run / "run.json")
        records = Records(kept.rows(run / "records.parquet"))
        every = kept.rows(raw) if raw.is_file() else []
        chosen = [row for row in every if row["metric"] == "inversion_nmse"]
    except ValueError as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    return about, records, Records(chosen) if chosen else None


def read_play(run: Path) -> dict[str, Any] | None:
    """The law that the page rolls, if the run has one in ``play.json``."""
    path = run / "play.json"
    return kept.words(path) if path.is_file() else None


def _sentences(records: Records, about: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        ("Asked:", asked(records, about)),
        ("Holds:", holds(records)),
        ("Does not, or is not known:", fails(records, about)),
    ]


def _first(
    run: Path,
    about: Mapping[str, Any],
    records: Records,
    references: Mapping[str, float],
    raw: Records | None,
) -> list[dict[str, Any]]:
    """The first table: a row a model, with how to repeat it and how to look at it."""
    told = _episodes(raw) if raw else {}
    rows = []
    for lines in records.rungs.values():
        twin = next((line for line in lines if line.head == TWIN), None)
        for line in lines:
            error = records.pick(line, "inversion_nmse", coupling=records.coupling)
            drift = records.pick(line, "energy_drift_median", horizon=records.horizon)
            study = references.get(f"{line.grounding}/{line.head}")
            if line.readout == "shooting":  # which the study does not have
                study = None
            verdict = (
                tables.verdict_cell(records, line, twin)
                if line.head.startswith("factored")
                else Cell("the twin" if line is twin else "", kind="said")
            )
            rows.append(
                {
                    "line": line,
                    "colour": figures.style(line.head, records.heads)[0],
                    "again": _again(about, line),
                    "view": _view(run, line),
                    "episodes": told.get(f"{line.grounding}/{line.head} {line.readout}", ""),
                    "cells": [
                        verdict,
                        mean_cell(error),
                        NOT_MEASURED if study is None else Cell(number(study), study),
                        chosen_cell(drift, median),
                    ],
                }
            )
    return rows


def _again(about: Mapping[str, Any], line: Line) -> str:
    """The command that measures one cell again."""
    settings = about.get("settings") or {}
    seeds = settings.get("seeds") or about.get("seeds") or [0]
    preset = settings.get("preset") or about.get("preset") or "quick"
    return (
        f"vidphys ladder --preset {preset} --cells {line.grounding}/{line.head} "
        f"--seed {min(seeds)} --seeds {len(seeds)} --out runs/again"
    )


def _view(run: Path, line: Line) -> str:
    """The command that shows one cell, where it has something to show."""
    stem = f"{line.grounding}-{line.head}"
    if not (run / "showcase" / f"{stem}.safetensors").is_file():
        return ""
    return f"vidphys view {typed(run)} --cell {line.grounding}/{line.head}"


def _episodes(raw: Records) -> dict[str, str]:
    """The worst, the median and the best episode of each cell and readout, in words."""
    found: dict[str, list[tuple[float, int, int]]] = {}
    for row in raw.rows:
        if row["coupling"] == raw.coupling and row["status"] == "ok" and row["value"] is not None:
            key = f"{row['grounding']}/{row['head']} {row['readout']}"
            place = int(row["seed"]), int(row.get("episode") or 0)
            found.setdefault(key, []).append((float(row["value"]), *place))
    told = {}
    for key, values in found.items():
        values.sort()
        chosen = {"Worst": values[-1], "median": values[len(values) // 2], "best": values[0]}
        words = [
            f"{name} episode {episode} of seed {seed}: {number(value)}"
            for name, (value, seed, episode) in chosen.items()
        ]
        told[key] = "; ".join(words) + f" ({len(values)} episodes)."
    return told
