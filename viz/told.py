"""The report of one recording's run: a diagnosis, a fit, a training or a rollout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from viz import kept
from viz.cells import Cell, number
from viz.figures import save_svg
from viz.page import Drawn, inline_svg, write_page
from viz.paths import typed

TITLES = {
    "diagnose": "What law moves this",
    "fit": "A model of exactly these terms",
    "train": "Readouts and dynamics, trained on clips",
    "rollout": "Rolled on",
}
NORMAL_95 = 1.959964
OPEN = (
    "Not certain",
    "Nearly as likely",
    "In doubt",
    "No term",
    "Not explained",
    "No answer",
    "What is left",
    "The model follows",
)
BODIES = ("Body ", "The body ")
FORECAST = "forecast rmse normalised"
WITHOUT_MODEL = {
    "clip/persistence": "standing still",
    "clip/constant-velocity": "going straight on",
}
FEW = 4  # entries of a setting, that the page shows
KNOWN = ("experiment", "cells")  # settings that the title says
STATIC = ("run.json", "records.parquet", "report.html", ".lock")


def write_told(run: Path) -> Path:
    """Write ``report.html`` of the run folder of one recording, from what lies in it.

    Raises:
        ValueError: ``run.json`` is missing or cannot be read, or is of another kind of run.
    """
    try:
        about = kept.words(run / "run.json")
        settings = about["settings"]
    except (ValueError, KeyError) as error:
        raise ValueError(f"report: {run} cannot be read: {error}") from error
    kind = settings.get("experiment")
    if kind not in TITLES:
        raise ValueError(f"report: {run} is a run of '{kind}', which has no report of this kind")
    said, rows, found = _summary(run), _records(run), _found(run)
    sentences = _of_diagnosis(settings, said) if said else _of_run(kind, settings)
    more = _of_forecasts(rows) if kind == "train" else []
    more += _of_rollout(about) if kind == "rollout" else []
    told = {
        "title": TITLES[kind],
        "sentences": sentences + more,
        "figure": _figure(run, kind, _other_law(settings)),
        "law": _law(found),
        "equations": _equations(found),
        "rows": rows,
        "commands": _commands(run, kind),
        "said": said,
        "files": sorted(
            str(file.relative_to(run))
            for file in run.rglob("*")
            if file.is_file()
            and not {"parts", "checkpoints"} & set(file.relative_to(run).parts)
            and file.name not in STATIC
        ),
        "settings": {
            name: _setting(value)
            for name, value in settings.items()
            if value not in (None, []) and name not in KNOWN
        },
    }
    return write_page(run, "told.html", told)


def _setting(value: Any) -> Any:
    """A value for a line of the table; of a mapping that fills pages how much it has."""
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{len(value)}, in run.json" if isinstance(value, dict) and len(value) > FEW else value


def _summary(run: Path) -> list[str]:
    file = run / "summary.txt"
    return file.read_text(encoding="utf-8").splitlines() if file.is_file() else []


def _of_diagnosis(settings: Mapping[str, Any], said: Sequence[str]) -> list[tuple[str, str]]:
    """What was asked, what holds and what is open, of the summary's lines."""
    first = next((k for k, line in enumerate(said) if line.startswith("Frames ")), 0)
    told = [line for line in said[first + 1 :] if not line.startswith(" ")]
    left = [line for line in said[first + 1 :] if line.startswith(OPEN)]
    laws = [line for line in told[1:] if line.startswith(BODIES)] or told[1:2]
    held = [line for line in told[:1] + laws if line not in left]
    return [
        (
            "Asked:",
            f"which law moves the bodies of {settings.get('input', 'a recording')}. {said[first]}",
        ),
        ("Holds:", " ".join(held) or "nothing that can be told."),
        ("Open:", " ".join(left) or "nothing that the recording could tell."),
    ]


def _of_run(kind: str, settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """What was asked of a model; what holds stands in the numbers."""
    if kind == "rollout":
        other = _other_law(settings)
        other = f", and under another law: {other}" if other else ""
        return [("Asked:", f"how it goes on for {settings.get('beyond')} s{other}.")]
    if kind == "fit":
        return [("Asked:", "the numbers of a law whose terms a diagnosis gave.")]
    seen = settings.get("encoder")
    return [("Asked:", f"what can be read and foretold of clips{f' over {seen}' if seen else ''}.")]


def _other_law(settings: Mapping[str, Any]) -> str:
    """What a rollout was changed by, in words; nothing where it was not."""
    coupling = settings.get("coupling")
    words = [] if coupling is None else [f"G = {coupling:g}".replace("-", "\u2212")]
    return ", ".join(
        [*words, *(" times ".join(x.split("=", 1)) for x in settings.get("law") or ())]
    )


def _of_rollout(about: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Whether the clip is like those that the model was trained on, and what cannot be known."""
    flags = (about.get("flags") or {}).values()
    unlike = [flag["said"] for flag in flags if flag["raised"]]
    if unlike:
        first = [("Open:", f"the clip is unlike those of the training: {'; '.join(unlike)}.")]
    elif flags:
        first = [
            ("Holds:", "the clip is like those of the training, in what is seen and in its law.")
        ]
    else:
        first = []
    return [*first, ("Not known:", "how far it is off: nothing was recorded that far on.")]


def _of_forecasts(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Whether the trained model foretells better than what needs no model."""
    found = {
        row["cell"]: row["value"].value
        for row in rows
        if row["metric"] == FORECAST and row["value"].value is not None
    }
    model, plain = found.get("clip/factored"), {x: found[x] for x in WITHOUT_MODEL if x in found}
    if model is None or not plain:
        return []
    best = min(plain, key=lambda name: plain[name])
    lead, word = ("Holds:", "better") if model < plain[best] else ("Open:", "no better")
    return [
        (
            lead,
            f"the factored model foretells {word} than {WITHOUT_MODEL[best]}: "
            f"RMSE {number(model)} against {number(plain[best])}, in normalised image units.",
        )
    ]


def _found(run: Path) -> dict[str, Any]:
    """What a diagnosis left there; nothing where it did not."""
    path = run / "diagnosis.json"
    return kept.words(path) if path.is_file() else {}


def _laws(data: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any], Mapping[str, Any]]]:
    """Of a body or a group of them at a time: whose law it is, its numbers and its equation."""
    parts = [
        (_bodies(part["bodies"]), part["quantities"], part.get("equation") or {})
        for part in data.get("mechanism") or ()
    ]
    formula = data.get("formula")
    if formula:
        words = ((x["word"], x["numbers"]) for x in formula["words"])
        numbers = {f"{word}: {name}": x for word, told in words for name, x in told.items()}
        return [("formula", numbers, {"text": formula["equation"]})]
    return parts or [
        ("terms", part["quantities"], part.get("equation") or {})
        for part in data.get("parts") or ()
    ]


def _equations(data: Mapping[str, Any]) -> list[str]:
    return [equation["text"] for _, _, equation in _laws(data) if equation]


def _law(data: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The numbers of a diagnosed law, with 95 % intervals and their letters in its equation."""
    parts = _laws(data)
    if any(of == "terms" for of, *_ in parts):
        parts += [(_bodies([n]), found, {}) for n, found in enumerate(_masses(data))]
    return [
        {
            "of": of,
            "name": name,
            "letter": equation.get("symbols", {}).get(name, ""),
            "value": _value(found),
            "unit": found.get("unit") or "",
        }
        for of, numbers, equation in parts
        for name, found in numbers.items()
    ]


def _masses(data: Mapping[str, Any]) -> list[dict[str, dict[str, Any]]]:
    """Of each body where they differ, as the terms' numbers are told for."""
    mass = data.get("mass") or []
    if len(set(mass)) < 2:
        return []
    return [{"mass": {"value": value}} for value in mass]


def _bodies(which: Sequence[int]) -> str:
    return f"bod{'ies' if len(which) > 1 else 'y'} {', '.join(str(n + 1) for n in which)}"


def _value(found: Mapping[str, Any]) -> Cell:
    value, error = found.get("value"), found.get("standard_error")
    if value is None:
        return Cell("not known")
    if error is None or not np.isfinite(error):
        return Cell(number(value), value)
    half = NORMAL_95 * error
    if not found.get("known", True):
        return Cell(f"not told, between {number(value - half)} and {number(value + half)}")
    places = 1 - int(np.floor(np.log10(half))) if half > 0 else 3
    after = max(places, 0)
    text = f"{round(value, places):.{after}f} ± {round(half, places):.{after}f}"
    return Cell(text if after < 7 else number(value), value)


def _records(run: Path) -> list[dict[str, Any]]:
    """Every number of the records."""
    file = run / "records.parquet"
    if not file.is_file():
        return []
    return [
        {
            "cell": row["cell"],
            "metric": row["metric"].replace("_", " "),
            "value": Cell("", None, (), ((row["status"], "bad"),))
            if row["value"] is None
            else Cell(number(row["value"]), row["value"]),
        }
        for row in kept.rows(file)
    ]


def _figure(run: Path, kind: str, other: str) -> Drawn | None:
    """The figure as it lies there, or one drawn of a rollout's arrays."""
    path = run / "figures" / ("clip.svg" if kind == "train" else "diagnosis.svg")
    if kind == "rollout":
        path = run / "figures" / "rollout.svg"
        if not _draw_rollout(run, path, other):
            return None
    if not path.is_file():
        return None
    caption = "Dots: recorded. Lines: the model; dashed: other laws. A hue is a body."
    if kind in ("rollout", "train"):
        caption += " Shaded: what is foretold."
    return inline_svg(
        path.read_text(encoding="utf-8"), "Tracks and the model along each axis", caption
    )


def _draw_rollout(run: Path, path: Path, other: str) -> bool:
    """Tracks, how they go on, and how they would under the other law."""
    from viz.going_on import FORETOLD, going_on_figure

    if not (run / "rollout.npz").is_file():
        return False
    arrays = kept.arrays(run / "rollout.npz")
    when = arrays["rollout_times"]
    rolled = {FORETOLD: (when, arrays["rollout"])}
    if "changed" in arrays:
        rolled[f"under {other}" if other else "under another law"] = when, arrays["changed"]
    save_svg(going_on_figure(arrays["times"], arrays["track"], rolled), path)
    return True


def _commands(run: Path, kind: str) -> list[tuple[str, str]]:
    """What may be done next, as it is typed."""
    here = typed(run)
    found = []
    if any((run / "recordings").glob("*.rrd")):
        found.append(("look", f"vidphys view {here}"))
    if kind == "diagnose" and (run / "specification.json").is_file():
        tracks = f"{here}/tracks.csv" if (run / "tracks.csv").is_file() else "TRACKS"
        command = (
            f"vidphys fit {tracks} --specification {here}/specification.json --out runs/fitted"
        )
        found.append(("train this model", command))
    if kind in ("fit", "train"):
        clip = " CLIP" if kind == "train" else ""  # a fit rolls on what it was made of
        found.append(("roll it on", f"vidphys rollout {here}{clip} --beyond 5 --out runs/rolled"))
    return found
