"""``python -m vidphys.pretraining.figure RUN``: what training adds to encoders, from an atlas."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from vidphys.errors import InputError
from vidphys.probing.atlas import NAME, SCORE
from vidphys.probing.controls import PIXELS, RANDOM
from vidphys.probing.scores import Score
from vidphys.runs.atomic import write_with
from vidphys.runs.records import read_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

CONTROL = "control/"
# Okabe and Ito's, and a shape each: told apart without colour as well
STYLES = {SCORE: ("trained", "#0072B2", "o"), RANDOM: ("random weights", "#D55E00", "s")}
APART = 0.16  # of the two marks of an encoder, in rows
WIDTH, ROW, REST = 2.9, 0.34, 1.3  # inches: of a target, of an encoder, of all else in height


@dataclass(frozen=True)
class FigureConfig:
    """Draw what encoders know beside the same encoders with random weights; print it as a table.

    Each is read at the layer that knows most of the target, trained and random apart.

    Example: python -m vidphys.pretraining.figure runs/atlas --out runs/tiny-encoders.svg

    Args:
        atlas: run folder of `vidphys atlas`, of one seed.
        out: the picture, in SVG.
    """

    atlas: Annotated[Path, tyro.conf.Positional]
    out: Path


@dataclass(frozen=True)
class Gain:
    """What one encoder knows of one target.

    Args:
        encoder, target: by name.
        trained, random: scores of the best layer of each, with their 95 % intervals by clip.
        pixels: the score of the pixels themselves.
    """

    encoder: str
    target: str
    trained: Score
    random: Score
    pixels: float


def gains(rows: Sequence[Mapping[str, Any]]) -> list[Gain]:
    """What an atlas of one seed found, a target after the other.

    Raises:
        InputError: records of anything else.
    """
    if {row["experiment"] for row in rows} != {NAME} or len({row["seed"] for row in rows}) != 1:
        raise InputError("figure: needs the records of `vidphys atlas` with one seed")
    spots: dict[tuple[str, str], dict[str, dict[str, float]]] = {}
    for row in rows:
        layer, _, target = row["cell"].removeprefix(f"{row['encoder']}/").partition("/")
        if target:
            layers = spots.setdefault((target, row["encoder"]), {})
            layers.setdefault(layer, {})[row["metric"]] = row["value"]
    return [
        Gain(
            encoder,
            target,
            _best(layers, SCORE),
            _best(layers, CONTROL + RANDOM),
            _best(layers, CONTROL + PIXELS).value,
        )
        for (target, encoder), layers in sorted(spots.items())
    ]


def _best(layers: Mapping[str, Mapping[str, float]], metric: str) -> Score:
    found = [Score(*(n[metric + end] for end in ("", "_low", "_high"))) for n in layers.values()]
    return max(found, key=lambda score: score.value)


def table(found: Sequence[Gain]) -> str:
    """Rows of Markdown."""
    lines = ["| target | encoder | trained | random weights | pixels |", "|---|---|---|---|---|"]
    for each in found:
        cells = (each.target, f"`{each.encoder}`", _told(each.trained), _told(each.random))
        lines.append(f"| {' | '.join(cells)} | {_number(each.pixels)} |")
    return "\n".join(lines)


def _told(score: Score) -> str:
    return f"{_number(score.value)} [{_number(score.low)}, {_number(score.high)}]"


def _number(value: float) -> str:
    return f"{round(value, 2) + 0.0:.2f}".replace("-", "−")  # + 0: no minus before zero


def figure(found: Sequence[Gain], words: str) -> Figure:
    """A panel a target, a row an encoder; marks are scores, bars their intervals.

    Args:
        found: of every target and encoder.
        words: below the panels.
    """
    from matplotlib.figure import Figure

    targets = list(dict.fromkeys(each.target for each in found))
    encoders = list(dict.fromkeys(each.encoder for each in found))
    size = 1.5 + WIDTH * len(targets), REST + ROW * len(encoders)
    drawn = Figure(figsize=size, layout="constrained")
    panels = drawn.subplots(1, len(targets), sharey=True, squeeze=False)[0]
    for panel, target in zip(panels, targets, strict=True):
        _panel(panel, [each for each in found if each.target == target], encoders)
        panel.set_title(target)
    panels[0].set_yticks(range(len(encoders)), encoders)
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc="outside upper center", ncols=3, frameon=False)
    drawn.supxlabel(words, fontsize="medium")
    return drawn


def _panel(panel: Axes, found: Sequence[Gain], encoders: Sequence[str]) -> None:
    for side, (kind, (label, colour, marker)) in zip((-APART, APART), STYLES.items(), strict=True):
        scores = [each.trained if kind == SCORE else each.random for each in found]
        values = [score.value for score in scores]
        ends = [
            [score.value - score.low for score in scores],
            [score.high - score.value for score in scores],
        ]
        rows = [encoders.index(each.encoder) + side for each in found]
        panel.errorbar(
            values,
            rows,
            xerr=ends,
            label=label,
            color=colour,
            marker=marker,
            linestyle="none",
            capsize=2,
        )
    panel.axvline(found[0].pixels, color="#7F7F7F", linestyle=":", label="pixels")
    panel.spines[["top", "right"]].set_visible(False)


def write_figure(atlas: Path, out: Path) -> list[Gain]:
    """Draw the figure of an atlas.

    Args:
        atlas: its run folder.
        out: SVG file.

    Returns:
        What is drawn.

    Raises:
        InputError: no such folder, or other records; see :func:`gains`.
    """
    import matplotlib

    path = atlas / "records.parquet"
    if not path.is_file():
        raise InputError(f"figure: {path} is not there; run `vidphys atlas` first")
    rows = read_table(path).to_pylist()
    found = gains(rows)
    words = f"score: 1 perfect, 0 chance; seed {rows[0]['seed']} ({rows[0]['role']}), 95 % by clip"
    look: dict[Any, Any] = {"svg.hashsalt": "vidphys", "svg.fonttype": "none"}
    with matplotlib.rc_context(look):
        drawn, about = figure(found, words), {"Date": None, "Creator": None}
        write_with(out, lambda part: drawn.savefig(part, format="svg", metadata=about))
    return found


def main() -> int:
    """Returns the exit code: 0 done, 2 wrong input."""
    config = tyro.cli(FigureConfig, prog="python -m vidphys.pretraining.figure")
    try:
        print(table(write_figure(config.atlas, config.out)))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"figure: {config.out}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
