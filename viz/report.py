"""The report of a run folder: one HTML file that opens offline and says what the records say."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from viz import figures, tables
from viz.cells import chip, number, tally
from viz.explain import how_to_read, what_spread_means
from viz.overlay import contact_sheet
from viz.page import heading, inline_png, inline_svg, paragraph, section, write_page
from viz.roles import by_role, development, named
from viz.showcase import read_showcase
from viz.summary import SKILL_BAR, TWIN, Line, Records

SHEET_HEADS = ("factored", TWIN)  # whose showcases are drawn in the report


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
    experiment = str(about.get("experiment") or records.rows[0].get("experiment") or "run")
    title = "The grounding ladder" if experiment == "ladder" else experiment
    sections = [
        _short(records),
        _troubles(about, records),
        _ladder(run, about, records),
        section("read", "How to read this", *map(paragraph, how_to_read())),
        _force(run, records),
        _couplings(records, episodes),
        _drift(run, records),
        _perception(records),
        _others(records),
        _sheets(run, records),
        development(older),
        _settings(about, every),
    ]
    kept = [part for part in sections if part]
    return write_page(run, title, _heading(title, about, every), kept)


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


def _heading(title: str, about: Mapping[str, Any], records: Records) -> str:
    settings = _flat(about.get("settings") or {})
    old = sum(bool(row.get("stale")) for row in records.rows)
    facts = {
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
    items = "".join(
        f"<div><dt>{name}</dt><dd>{escape(value or 'not recorded')}</dd></div>"
        for name, value in facts.items()
    )
    lead = (
        "Models trained under one law, asked what happens under another: can each of them say how "
        "the bodies move once the coupling changes sign, and does its energy hold?"
    )
    return f'{heading(title, lead)}<dl class="facts">{items}</dl>'


def _short(records: Records) -> str:
    """Counts, and each factored head against its twin."""
    status = Counter(str(row["status"]) for row in records.rows)
    tones = {"ok": "good", "skipped": "dull"}
    counts = tally(
        (f"{count:,} numbers {name}", tones.get(name, "bad"))
        for name, count in status.most_common()
    )
    if not records.couplings:
        return section("short", "In short", counts)
    parts = []
    for name, wanted in (("factored heads", "factored"), ("unstructured twins", TWIN)):
        lines = [line for line in records.lines if line.head.startswith(wanted)]
        skills = [records.pick(x, "ballistic_skill", coupling=records.coupling) for x in lines]
        hits = sum(bool(s and s.values and not s.bad and max(s.values) < SKILL_BAR) for s in skills)
        parts.append(f"{hits} of {len(lines)} {name} invert")
    sentence = (
        f"{'; '.join(parts)}. To invert is to have an error below {SKILL_BAR:g} of the zero-force "
        "predictor's on every seed, with nothing failed or invalid."
    )
    table = tables.verdict_table(records)
    return section("short", "In short", paragraph(sentence), counts, table, _note(records))


def _troubles(about: Mapping[str, Any], records: Records) -> str:
    """Everything without a number that counts, and every claim that did not hold."""
    missing = [
        f"{chip('skipped', 'dull')} <b>{escape(str(entry.get('cell')))}</b>: "
        f"{escape(str(entry.get('reason') or 'no reason recorded'))}"
        for entry in about.get("skipped") or []
    ]
    negative = []
    for lines in records.rungs.values():
        twin = next((line for line in lines if line.head == TWIN), None)
        for line in lines:
            name = f"<b>{escape(line.rung)}</b> with {escape(line.head)}"
            for status, metrics in sorted(records.troubles(line).items()):
                words = _which(records, line, metrics)
                missing.append(f"{chip(status, 'bad')} {name}: {escape(words)}")
            if records.couplings and line.head.startswith("factored"):
                word, why = tables.verdict(records, line, twin)
                if word != tables.HOLDS:
                    negative.append(f"{chip(word, 'bad')} {name}: {escape(why)}")
    parts = [
        "<h3>Without a number that counts</h3>",
        _callout(missing, "Nothing failed, was invalid, or was skipped."),
    ]
    if records.couplings:
        parts += [
            "<h3>Factored heads whose claim does not hold here, or has no verdict</h3>",
            _callout(negative, "Every factored head inverts, and its twin is worse on every seed."),
        ]
    return section("troubles", "What failed, and what did not hold", *parts)


def _which(records: Records, line: Line, metrics: Mapping[str, list[int]]) -> str:
    """Metrics and seeds in words, short where it is all of them."""
    seeds = sorted({seed for found in metrics.values() for seed in found})
    every = seeds == records.seeds(line)
    named = "every seed" if every else f"seed {', '.join(map(str, seeds))}"
    everything = all(m in metrics for m in records.metrics if records.pick(line, m))
    return f"{'every metric' if everything else ', '.join(sorted(metrics))} ({named})"


def _callout(items: list[str], none: str) -> str:
    if not items:
        return f'<div class="callout calm"><p>{escape(none)}</p></div>'
    return f'<div class="callout"><ul>{"".join(f"<li>{x}</li>" for x in items)}</ul></div>'


def _ladder(run: Path, about: Mapping[str, Any], records: Records) -> str:
    if not records.couplings:
        return ""
    told = (about.get("settings") or {}).get("tables", {}).get("ladder", {})
    picture = _drawn(
        run,
        "ladder",
        figures.ladder_figure(records, told.get("references")),
        "Error under the flipped coupling by rung and head",
        "Large mark: mean over seeds; small marks: seeds. Left is better. A mark right of the "
        "dotted line is worse than assuming that no force acts at all.",
    )
    table = tables.ladder_table(records)
    return section("ladder", "The ladder", picture, table, _note(records))


def _note(records: Records) -> str:
    return f'<p class="note">{escape(what_spread_means(records))}</p>'


def _force(run: Path, records: Records) -> str:
    if "force_cosine" not in records.metrics:
        return ""
    picture = _drawn(
        run,
        "force_cosine",
        figures.force_figure(records),
        "Force cosine by rung and head",
        "Large mark: mean over seeds; small marks: seeds. A head far from 1 does not know the "
        "force, whatever its error over a short rollout says.",
    )
    return section("force", "Which force was learned", picture)


def _couplings(records: Records, episodes: Records | None) -> str:
    if not records.couplings:
        return ""
    apart = []
    for g in records.couplings:
        found = [records.pick(line, "truth_distance", coupling=g) for line in records.lines]
        values = [value for one in found if one for value in one.values]
        if values:
            apart.append(f"{number(sum(values) / len(values))} at G = {g:g}")
    text = (
        f"The two truths, changed law and old law, are themselves apart by an nMSE of "
        f"{', '.join(apart)} (mean over all rows): an error near that says that the change was "
        "missed."
    )
    table = tables.couplings_table(records, episodes)
    return section("couplings", "All couplings", paragraph(text) if apart else "", table)


def _drift(run: Path, records: Records) -> str:
    if not records.horizons:
        return ""
    picture = _drawn(
        run,
        "drift",
        figures.drift_figure(records),
        "Energy drift against simulation steps by rung and head",
        "Line: median episode; band: up to the worst episode of any seed. At the dotted line the "
        f"error is as large as the energy itself. Drifts above {figures.DRIFT_CAP:,.0f} are drawn "
        "there.",
    )
    return section("drift", "Does the energy hold", picture, tables.drift_table(records))


def _perception(records: Records) -> str:
    table = tables.perception_table(records)
    text = "Errors of the perceived state at t = 0, before anything was rolled forward."
    return section("perception", "What was perceived", paragraph(text), table) if table else ""


def _others(records: Records) -> str:
    table = tables.other_table(records)
    return section("others", "Other numbers", table) if table else ""


def _sheets(run: Path, records: Records) -> str:
    """The showcase episodes of the factored heads and of their twins."""
    parts: list[str] = []
    cells = [f"{x.grounding}/{x.head}" for x in records.lines if x.head in SHEET_HEADS]
    for cell in dict.fromkeys(cells):
        stem = cell.replace("/", "-")
        file = run / "showcase" / f"{stem}.safetensors"
        if not file.is_file():
            continue
        path = run / "figures" / f"showcase-{stem}.png"
        showcase, meta = read_showcase(file)
        figures.save_png(contact_sheet(showcase, {"cell": cell, **meta}), path, dots_per_inch=90)
        picture = inline_png(path.read_bytes(), f"One episode of {cell}", "")
        opened = "" if parts else " open"
        parts.append(f"<details{opened}><summary>{escape(cell)}</summary>{picture}</details>")
    if not parts:
        return ""
    text = (
        "One test episode of each cell: what was observed, then both laws rolled forward. "
        "The command vidphys view shows it in time."
    )
    return section("episodes", "One episode, seen", paragraph(text), *parts)


def _settings(about: Mapping[str, Any], records: Records) -> str:
    rows = {**_flat(about.get("settings") or {})}
    versions = {f"version of {k}": v for k, v in (about.get("versions") or {}).items()}
    rest = {k: about[k] for k in ("schema_version",) if k in about}
    body = "".join(
        f'<tr><th scope="row" class="head">{escape(str(k))}</th><td>{escape(str(v))}</td></tr>'
        for k, v in {**rows, **versions, **rest}.items()
    )
    head = '<tr><th scope="col">setting</th><th scope="col">value</th></tr>'
    note = (
        f"{len(records.rows):,} records: {', '.join(records.metrics)}. Each of them stands in "
        "records.parquet; episodes.parquet has the raw numbers of every episode, run.json all "
        "settings, recordings/ one recording a cell."
    )
    table = f'<div class="scroll"><table class="settings">{head}{body}</table></div>'
    return section("settings", "What was run", paragraph(note), table)


def _drawn(run: Path, name: str, figure: Any, label: str, caption: str) -> str:
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
