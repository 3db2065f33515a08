"""What is said beside a recording: what its model was trained on and asked, and how it did."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from viz import kept
from viz.cells import number
from viz.sentences import law, verdicts
from viz.showcase import Arrays
from viz.summary import SKILL_BAR, Line, Records

ROLLED = "rolled out"
READINGS = ("shooting", "none")  # of several, the recording is of the first


def story(run: Path, about: Mapping[str, str]) -> dict[str, str]:
    """What a showcase says of itself, and what the records of its run say of its cell.

    Args:
        run: the folder; nothing is added where it has no records yet.
        about: ``cell``, ``seed`` and ``coupling`` of the showcase.
    """
    told = dict(about)
    if "coupling" in about:
        told["trained on"] = "G > 0 only"
        told["asked"] = f"to go on under {law(float(about['coupling']))}, and under G = −1"
    try:
        records = Records(kept.rows(run / "records.parquet"))
    except ValueError:
        return told
    line = _line(records, about.get("cell", ""))
    return told if line is None else told | _numbers(records, line)


def _line(records: Records, cell: str) -> Line | None:
    """Of the cell, under the readout that is shown."""
    rows = [r for r in records.rows if r.get("cell", f"{r['grounding']}/{r['head']}") == cell]
    lines = {row["readout"]: Line(row["grounding"], row["readout"], row["head"]) for row in rows}
    return next((lines[readout] for readout in READINGS if readout in lines), None)


def _numbers(records: Records, line: Line) -> dict[str, str]:
    g, found = records.coupling, {}
    for metric, name, more in (
        ("inversion_nmse", f"error under {law(g)} (nMSE)", ""),
        ("ballistic_skill", "skill", f" of the error without any force; below {SKILL_BAR} counts"),
    ):
        summary = records.pick(line, metric, coupling=g)
        if summary is not None:
            value = summary.words if summary.mean is None else number(summary.mean) + more
            found[name] = value
    for one, word, why in verdicts(records):
        if one == line:
            found["verdict"] = f"{word}: {why}" if why else word
    return found


def marks(showcase: Arrays) -> dict[float, str]:
    """Instants at which something happens to bodies, seconds, in words.

    A role that is no longer finite; the nearest that bodies come to each other in truth.
    """
    times, found = np.asarray(showcase["times"], np.float64), {}
    for role, name in (("prediction", "the model"), ("counterfactual", "the model, flipped")):
        wrong = ~np.isfinite(showcase[role]).all((1, 2)) & (times >= 0)
        if wrong.any():
            found[float(times[int(wrong.argmax())])] = f"{name} is not finite"
    places = np.asarray(showcase["truth"], np.float64)[times > 0]
    if len(places) and places.shape[1] > 1:
        first, second = np.triu_indices(places.shape[1], 1)
        gaps = np.linalg.norm(places[:, first] - places[:, second], axis=-1).min(1)
        if np.isfinite(gaps).any():
            nearest, after = int(np.nanargmin(gaps)), times[times > 0]
            found[float(after[nearest])] = f"closest approach, {number(gaps[nearest])}"
            for later in after[nearest + 1 : nearest + 2]:
                found.setdefault(float(later), ROLLED)
    return found
