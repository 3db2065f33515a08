"""The report of a run folder: one HTML file that opens offline and says what the records say."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from viz import figures, tables
from viz.cells import NOT_MEASURED, Cell, chosen_cell, mean_cell, number
from viz.explain import how_to_read, what_spread_means
from viz.headline import headline
from viz.moving import moving_pair
from viz.overlay import contact_sheet
from viz.page import Drawn, inline_png, inline_svg, write_page
from viz.paths import typed
from viz.roles import by_role, looked_at, named
from viz.sentences import asked, fails, holds, law, verdicts
from viz.showcase import read_showcase
from viz.summary import TWIN, Line, Records, median

SHEET_BYTES = 400_000  # of pictures that the page holds; all of them lie in figures/
SHEET_HEADS = ("factored", TWIN)  # whose showcases are drawn in the report
TONES = {"ok": "good", "skipped": "dull", "gate not passed": "dull"}


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
        _ladder(run, records, references),
        {"id": "read", "title": "How to read this", "texts": how_to_read()},
        _force(run, records),
        _couplings(records, episodes),
        _drift(run, records),
        _tabled("perception", "What was perceived", tables.perception_table(records), PERCEIVED),
        _tabled("others", "Other numbers", tables.other_table(records)),
        _sheets(run, records),
        _development(older),
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
        "tally": _tally(records),
        "facts": _facts(about, every),
        "missing": _missing(about, records),
        "negative": _negative(records) if ladder else None,
        "verdicts": tables.verdict_table(records) if ladder else None,
        "parts": [{**EMPTY, **part} for part in parts if part],
        "kept": _kept(every),
        "settings": _settings(about),
        "episodes": _episodes(raw) if raw else {},
    }
    return write_page(run, "ladder.html", told)


EMPTY: dict[str, Any] = {"texts": [], "figure": None, "table": None, "grey": False, "sheets": []}
PERCEIVED = "Errors of the perceived state at t = 0, before anything was rolled forward."


def read_run(run: Path) -> tuple[dict[str, Any], Records, Records | None]:
    """``run.json``, the records, and the per-episode inversion errors if there are any."""
    import pyarrow.parquet as pq

    for name in ("run.json", "records.parquet"):
        if not (run / name).is_file():
            raise ValueError(f"report: {run / name} is missing; give the folder of a run")
    raw = run / "episodes.parquet"
    try:
        about = json.loads((run / "run.json").read_text(encoding="utf-8"))
        records = Records(pq.read_table(run / "records.parquet").to_pylist())
        wanted = [("metric", "==", "inversion_nmse")]
        chosen = pq.read_table(raw, filters=wanted).to_pylist() if raw.is_file() else []
    except (OSError, ValueError) as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    return about, records, Records(chosen) if chosen else None


def read_play(run: Path) -> dict[str, Any] | None:
    """The law that the page rolls, if the run has one in ``play.json``."""
    try:
        return json.loads((run / "play.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


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


def _tally(records: Records) -> list[tuple[str, str]]:
    """How many numbers have which status."""
    status = Counter(str(row["status"]) for row in records.rows)
    return [
        (f"{count:,} numbers {name}", TONES.get(name, "bad"))
        for name, count in status.most_common()
    ]


def _facts(about: Mapping[str, Any], records: Records) -> dict[str, str]:
    settings = _flat(about.get("settings") or {})
    old = sum(bool(row.get("stale")) for row in records.rows)
    return {
        "preset": _fact(about, settings, "preset"),
        "seeds": named(records),
        "generator": _fact(about, settings, "generator"),
        "device": _fact(about, settings, "device") or _said(records, "device"),
        "dtype": _fact(about, settings, "dtype") or _said(records, "dtype"),
        "code version": _fact(about, settings, "code_version"),
        "stale": f"{old:,} of {len(records.rows):,} numbers: their code has changed since"
        if old
        else "nothing",
        "started": _fact(about, settings, "created").replace("T", " "),
    }


def _missing(about: Mapping[str, Any], records: Records) -> list[dict[str, Any]]:
    """Everything without a number that counts."""
    found: list[dict[str, Any]] = [
        {
            "mark": ("skipped", "dull"),
            "name": str(entry.get("cell")),
            "more": "",
            "why": str(entry.get("reason") or "no reason recorded"),
        }
        for entry in about.get("skipped") or []
    ]
    for line in records.lines:
        for status, metrics in sorted(records.troubles(line).items()):
            words = _which(records, line, metrics)
            found.append({**_item((status, "bad"), line), "why": words})
    return found


def _negative(records: Records) -> list[dict[str, Any]]:
    """Every claim that did not hold."""
    return [
        {**_item((word, tables.TONES[word]), line), "why": why}
        for line, word, why in verdicts(records)
        if word != tables.HOLDS
    ]


def _item(mark: tuple[str, str], line: Line) -> dict[str, Any]:
    return {"mark": mark, "name": line.rung, "more": f"with {line.head}"}


def _which(records: Records, line: Line, metrics: Mapping[str, list[int]]) -> str:
    """Metrics and seeds in words, short where it is all of them."""
    seeds = sorted({seed for found in metrics.values() for seed in found})
    every = seeds == records.seeds(line)
    told = "every seed" if every else f"seed {', '.join(map(str, seeds))}"
    everything = all(m in metrics for m in records.metrics if records.pick(line, m))
    return f"{'every metric' if everything else ', '.join(sorted(metrics))} ({told})"


def _ladder(run: Path, records: Records, references: Mapping[str, float]) -> dict[str, Any] | None:
    if not records.couplings:
        return None
    picture = _drawn(
        run,
        "ladder",
        figures.ladder_figure(records, references),
        "Error under the flipped coupling by rung and head",
        "Large mark: mean over seeds; small marks: seeds. Left is better. A mark right of the "
        "dotted line is worse than assuming that no force acts at all.",
    )
    return {
        "id": "ladder",
        "title": "The ladder, every head and reading",
        "texts": [what_spread_means(records)],
        "figure": picture,
        "table": tables.ladder_table(records),
    }


def _force(run: Path, records: Records) -> dict[str, Any] | None:
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


def _couplings(records: Records, episodes: Records | None) -> dict[str, Any] | None:
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


def _drift(run: Path, records: Records) -> dict[str, Any] | None:
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


def _tabled(
    name: str, title: str, table: tables.Table | None, text: str = ""
) -> dict[str, Any] | None:
    if table is None:
        return None
    return {"id": name, "title": title, "texts": [text] if text else [], "table": table}


def _sheets(run: Path, records: Records) -> dict[str, Any] | None:
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


def _development(older: Records | None) -> dict[str, Any] | None:
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


def _kept(records: Records) -> str:
    return (
        f"{len(records.rows):,} records: {', '.join(records.metrics)}. Each of them stands in "
        "records.parquet; episodes.parquet has the raw numbers of every episode, run.json all "
        "settings, recordings/ one recording a cell."
    )


def _settings(about: Mapping[str, Any]) -> dict[str, Any]:
    versions = {f"version of {k}": v for k, v in (about.get("versions") or {}).items()}
    rest = {k: about[k] for k in ("schema_version",) if k in about}
    return {**_flat(about.get("settings") or {}), **versions, **rest}


def _drawn(run: Path, name: str, figure: Any, label: str, caption: str) -> Drawn:
    """Keep a figure in ``figures/`` as vectors and pixels, and return it for the page."""
    path = run / "figures" / f"{name}.svg"
    figures.save_svg(figure, path)
    figures.save_png(figure, path.with_suffix(".png"))
    return inline_svg(path.read_text(encoding="utf-8"), label, caption)


def _fact(about: Mapping[str, Any], settings: Mapping[str, Any], name: str) -> str:
    """A fact of ``run.json``, or of its settings at any depth."""
    if about.get(name) is not None:
        return str(about[name])
    found = [str(v) for k, v in settings.items() if k.split(".")[-1] == name]
    return ", ".join(dict.fromkeys(found))


def _said(records: Records, column: str) -> str:
    return ", ".join(sorted({str(row[column]) for row in records.rows if row.get(column)}))


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat
