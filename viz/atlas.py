"""The report of ``atlas``: what each layer of each encoder knows, as a map read at once."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from viz.atlas_figures import Layer, Spot, cost_figure, depth_map
from viz.figures import save_svg
from viz.page import heading, inline_svg, paragraph, section, write_page

START = "control/"
LEAD = (
    "A score is 1 for perfect and about 0 for chance, on clips that the readout has not seen. "
    "A dot marks layers that are surely above random weights, pixels and permuted labels "
    "(95 %, by clip); a frame the best layer for a target."
)


def write_atlas(run: Path) -> Path:
    """Write ``report.html`` and ``figures/`` of a run folder from its records and choices.

    Raises:
        ValueError: the run's files are missing or cannot be read.
    """
    import pyarrow.parquet as pq

    try:
        about = json.loads((run / "run.json").read_text(encoding="utf-8"))
        said = json.loads((run / "atlas.json").read_text(encoding="utf-8"))
        rows = pq.read_table(run / "records.parquet").to_pylist()
    except (OSError, ValueError) as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    layers, spots = read_rows(rows)
    settings = about["settings"]
    lead = f"Clips of {settings['data']}, readout {settings['readout']}. {LEAD}"
    sections = [
        _short(said, about, rows),
        section("map", "The map", _drawn(run, "map", depth_map(layers, spots, _best(said)))),
        section("depth", "Is the middle special?", _list(d["sentence"] for d in said["depths"])),
        section("cost", "Cost beside accuracy", _cost(run, layers, spots, said)),
        section("controls", "All controls", _table(spots)),
    ]
    return write_page(run, "Atlas", heading("What each layer knows", escape(lead)), sections)


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


def _best(said: Mapping[str, Any]) -> dict[str, tuple[str, str]]:
    return {c["target"]: (c["encoder"], c["layer"]) for c in said["choices"]}


def _short(
    said: Mapping[str, Any], about: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]
) -> str:
    roles = sorted({f"{row['seed']} ({row['role']})" for row in rows})
    parts = [_list(c["sentence"] for c in said["choices"]), paragraph(f"Seeds {', '.join(roles)}.")]
    if about["skipped"]:
        lost = _list(f"{each['cell']}: {each['reason']}" for each in about["skipped"])
        parts.append(f'<div class="callout"><p>Not there:</p>{lost}</div>')
    return section("short", "In short", *parts)


def _list(sentences: Any) -> str:
    return "<ul>" + "".join(f"<li>{escape(each)}</li>" for each in sentences) + "</ul>"


def _cost(
    run: Path, layers: Sequence[Layer], spots: Sequence[Spot], said: Mapping[str, Any]
) -> str:
    fronts = {c["target"]: [tuple(each) for each in c["front"]] for c in said["choices"]}
    return _drawn(run, "cost", cost_figure(layers, spots, fronts))


def _drawn(run: Path, name: str, figure: Any) -> str:
    captions = {
        "map": "Columns are layers from the first to the last, rows are targets.",
        "cost": "The line is the front: nothing on it is beaten in both cost and score.",
    }
    path = run / "figures" / f"{name}.svg"
    save_svg(figure, path)
    return inline_svg(path.read_text(encoding="utf-8"), name, captions[name])


def _table(spots: Sequence[Spot]) -> str:
    names = list(
        dict.fromkeys(
            metric.removeprefix(START)
            for spot in spots
            for metric in spot.numbers
            if metric.startswith(START) and not metric.endswith(("_low", "_high"))
        )
    )
    head = "".join(
        f'<th scope="col">{escape(name)}</th>'
        for name in ("target", "encoder", "layer", "score", "selectivity", *names)
    )
    ordered = sorted(spots, key=lambda s: (s.target, s.encoder, s.numbers["depth"]))
    body = "".join(map(lambda spot: _line(spot, names), ordered))
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>{body}</table></div>'


def _line(spot: Spot, names: Sequence[str]) -> str:
    words = "".join(f"<td>{escape(t)}</td>" for t in (spot.target, spot.encoder, spot.layer))
    found = [_interval(spot, "score"), _interval(spot, "selectivity")]
    for name in names:
        value = spot.numbers.get(f"{START}{name}")
        found.append("" if value is None else f"{value:.2f}")
    numbers = "".join(f'<td class="num">{text}</td>' for text in found)
    return f"<tr>{words}{numbers}</tr>"


def _interval(spot: Spot, name: str) -> str:
    value, low, high = (spot.numbers[name + end] for end in ("", "_low", "_high"))
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"
