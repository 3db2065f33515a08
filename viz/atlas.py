"""The report of ``atlas``: what each layer of each encoder knows, as a map read at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from viz import kept
from viz.atlas_figures import Layer, Spot, cost_figure, depth_map
from viz.figures import save_svg
from viz.page import Drawn, inline_svg, write_page

START = "control/"
FORM = "form/"
KEPT = "kept/"
ENDS = ("_low", "_high")
MAP = "Columns are layers from the first to the last, rows are targets."
COST = "The line is the front: nothing on it is beaten in both; dotted is what pixels give."


def write_atlas(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder from its records and choices.

    Raises:
        ValueError: the run's files are missing or cannot be read.
    """
    try:
        about, said = kept.words(run / "run.json"), kept.words(run / "atlas.json", unsealed=0)
        records = kept.rows(run / "records.parquet")
    except ValueError as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    layers, spots = read_rows(records)
    fronts = {c["target"]: [tuple(each) for each in c["front"]] for c in said["choices"]}
    best = {c["target"]: (c["encoder"], c["layer"]) for c in said["choices"]}
    names = _named(START, spots)
    stays = _named(KEPT, spots)
    told = {
        "title": "What each layer knows",
        "lead": _lead(about["settings"], said, records),
        "map": _drawn(run, "map", depth_map(layers, spots, best), MAP),
        "cost": _drawn(run, "cost", cost_figure(layers, spots, fronts), COST),
        "choices": said["choices"],
        "depths": said["depths"],
        "skipped": about["skipped"],
        "columns": (
            "target",
            "encoder",
            "layer",
            "read by",
            "score",
            "selectivity",
            *names,
            *(f"change by {name}" for name in stays),
        ),
        "rows": [_row(spot, names, stays) for spot in sorted(spots, key=_in_order)],
    }
    return write_page(run, "atlas.html", told)


def read_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[list[Layer], list[Spot]]:
    """Layers in order of depth, and what each knows of each target; means over seeds."""
    numbers: dict[str, dict[str, list[float]]] = {}
    encoders: dict[str, str] = {}
    for row in rows:
        if row["value"] is not None:
            numbers.setdefault(row["cell"], {}).setdefault(row["metric"], []).append(row["value"])
            encoders[row["cell"]] = row["encoder"]
    means = {
        cell: {metric: sum(values) / len(values) for metric, values in found.items()}
        for cell, found in numbers.items()
    }
    spots = []
    for cell, found in means.items():
        if "score" in found:
            layer, _, target = cell.removeprefix(f"{encoders[cell]}/").partition("/")
            spots.append(Spot(encoders[cell], layer, target, found))
    depths = {(s.encoder, s.layer): s.numbers["depth"] for s in spots}
    layers = [
        Layer(encoder, layer, depth, means[f"{encoder}/{layer}"]["ms_per_clip"])
        for (encoder, layer), depth in depths.items()
    ]
    return layers, spots


def _lead(
    settings: Mapping[str, Any], said: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]
) -> str:
    """The result in a sentence."""
    sure = [
        c["target"] for c in said["choices"] if min(c["selectivity"]["low"], c["score"]["low"]) > 0
    ]
    seeds = ", ".join(sorted({f"{row['seed']} ({row['role']})" for row in rows}))
    found = (
        f"surely known beyond the controls: {', '.join(sure)}"
        if sure
        else "nothing is surely known beyond the controls"
    )
    return (
        f"Of {len(said['choices'])} targets in {settings['data']}, {found}. "
        f"Readout {settings['readout']}, seeds {seeds}."
    )


def _drawn(run: Path, name: str, figure: Any, caption: str) -> Drawn:
    path = run / "figures" / f"{name}.svg"
    save_svg(figure, path)
    return inline_svg(path.read_text(encoding="utf-8"), name, caption)


def _named(start: str, spots: Sequence[Spot]) -> list[str]:
    metrics = dict.fromkeys(metric for spot in spots for metric in spot.numbers)
    mine = [m for m in metrics if m.startswith(start) and not m.endswith(ENDS)]
    return [metric.removeprefix(start) for metric in mine]


def _in_order(spot: Spot) -> tuple[str, str, float]:
    return spot.target, spot.encoder, spot.numbers["depth"]


def _row(spot: Spot, names: Sequence[str], kept: Sequence[str]) -> dict[str, Any]:
    cells = [_interval(spot, "score"), _interval(spot, "selectivity")]
    for name in names:
        value = spot.numbers.get(f"{START}{name}")
        cells.append("" if value is None else f"{value:.2f}")
    for name in kept:
        bytes_each = spot.numbers.get(f"bytes/{name}")
        cells.append("" if bytes_each is None else f"{spot.numbers[KEPT + name]:+.3f}")
    return {"words": (spot.target, spot.encoder, spot.layer, _form(spot)), "cells": cells}


def _form(spot: Spot) -> str:
    """The form of the features that most folds took."""
    shares = {n.removeprefix(FORM): v for n, v in spot.numbers.items() if n.startswith(FORM)}
    return max(shares, key=lambda name: shares[name])


def _interval(spot: Spot, name: str) -> str:
    value, low, high = (spot.numbers[name + end] for end in ("", *ENDS))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"
