"""What a report says of a run beside its results: settings, what is missing, what did not hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from viz import tables
from viz.roles import named
from viz.sentences import verdicts
from viz.summary import Line, Records

TONES = {"ok": "good", "skipped": "dull", "gate not passed": "dull"}


def tally(records: Records) -> list[tuple[str, str]]:
    """How many numbers have which status."""
    status = Counter(str(row["status"]) for row in records.rows)
    return [
        (f"{count:,} numbers {name}", TONES.get(name, "bad"))
        for name, count in status.most_common()
    ]


def of_run(about: Mapping[str, Any], records: Records) -> dict[str, str]:
    """What the numbers are of: preset, seeds, device, code."""
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


def missing(about: Mapping[str, Any], records: Records) -> list[dict[str, Any]]:
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


def negative(records: Records) -> list[dict[str, Any]]:
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


def kept(records: Records) -> str:
    """What else lies in the folder."""
    return (
        f"{len(records.rows):,} records: {', '.join(records.metrics)}. Each of them stands in "
        "records.parquet; episodes.parquet has the raw numbers of every episode, run.json all "
        "settings, recordings/ one recording a cell."
    )


def settings(about: Mapping[str, Any]) -> dict[str, Any]:
    """Every setting and version, flat."""
    versions = {f"version of {k}": v for k, v in (about.get("versions") or {}).items()}
    rest = {k: about[k] for k in ("schema_version",) if k in about}
    return {**_flat(about.get("settings") or {}), **versions, **rest}


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
