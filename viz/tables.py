"""The report's tables: a row a line of the ladder, heads of a rung below one another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

from viz.cells import (
    NOT_MEASURED,
    Cell,
    Choice,
    chosen_cell,
    match_cell,
    mean_cell,
    nonfinite_cell,
    number,
    said,
    skill_cell,
)
from viz.figures import style
from viz.summary import SKILL_BAR, TWIN, Line, Records, median, paired

HOLDS, FAILS, NO_VERDICT = "holds", "does not hold", "no verdict"
TONES = {HOLDS: "good", FAILS: "bad", NO_VERDICT: "bad"}
PERCEPTION = {
    "position_nmse": "position nMSE at t = 0",
    "momentum_nmse": "momentum nMSE at t = 0",
    "affine_residual": "affine residual",
    "latent_growth": "latent growth",
    "in_distribution_nmse": "nMSE under the trained law",
    "lyapunov_time": "Lyapunov time, s",
}
SHOWN = {
    *PERCEPTION,
    "inversion_nmse",
    "regime_match",
    "regime_match_gated",
    "ballistic_skill",
    "ballistic_nmse",
    "truth_distance",
    "force_cosine",
    "energy_drift_median",
    "energy_drift_worst",
    "energy_drift_over_one",
    "retrace_nmse",
    "valid_time",
}


SEEN = {"supervision": "supervision", "knows": "knows of the pictures", "context": "frames seen"}


class Column(NamedTuple):
    """A column: the heading that it shares with its neighbours, its own, and its cells."""

    group: str
    label: str
    cell: Callable[[Line], Cell]


class TableRow(NamedTuple):
    """A line's cells; the first of a rung names it for ``opens`` rows, the others open none."""

    line: Line
    colour: str
    opens: int
    cells: list[Cell]


@dataclass(frozen=True)
class Table:
    """What a template draws: (group, its width) over labels, and rows."""

    groups: list[tuple[str, int]]
    labels: list[str]
    rows: list[TableRow]


def ladder_table(records: Records) -> Table:
    """The headline table."""
    g, steps, pick = records.coupling, records.horizon, records.pick
    flipped = "changed law" if g is None else f"changed law, G = {g:g}"
    long = "energy drift" if steps is None else f"energy drift at {steps:,} steps"

    def drift(metric: str, choose: Choice) -> Callable[[Line], Cell]:
        return lambda line: chosen_cell(pick(line, metric, horizon=steps), choose)

    def match(line: Line) -> Cell:
        plain = pick(line, "regime_match", coupling=g)
        return match_cell(plain, pick(line, "regime_match_gated", coupling=g))

    columns = [
        Column("", "status", lambda line: _status_cell(records, line)),
        *_seen(records),
        _mean(records, flipped, "inversion nMSE", "inversion_nmse", g),
        Column(flipped, "regime match", match),
        Column(
            flipped,
            "ballistic skill",
            lambda line: skill_cell(pick(line, "ballistic_skill", coupling=g)),
        ),
        _mean(records, flipped, "force cosine", "force_cosine", g),
        Column(long, "median", drift("energy_drift_median", median)),
        Column(long, "worst", drift("energy_drift_worst", max)),
        Column(
            long,
            "non-finite",
            lambda line: nonfinite_cell(pick(line, "energy_drift_median", horizon=steps)),
        ),
    ]
    return _table(records, records.lines, columns)


def _seen(records: Records) -> list[Column]:
    """How a line's states were perceived, where the records say it."""

    def told(column: str) -> Callable[[Line], Cell]:
        return lambda line: said(records.said(line, column))

    found = [c for c in SEEN if any(records.said(line, c) for line in records.lines)]
    return [Column("how it sees", SEEN[column], told(column)) for column in found]


def couplings_table(records: Records, episodes: Records | None) -> Table:
    """Every coupling that was tested: error, skill, match, force."""

    def match(g: float) -> Callable[[Line], Cell]:
        return lambda line: match_cell(records.pick(line, "regime_match", coupling=g))

    def typical(raw: Records, g: float) -> Callable[[Line], Cell]:
        return lambda line: chosen_cell(raw.pick(line, "inversion_nmse", coupling=g), median)

    columns = []
    for g in records.couplings:
        group = f"G = {g:g}"
        columns.append(_mean(records, group, "nMSE", "inversion_nmse", g))
        if episodes is not None:
            columns.append(Column(group, "median episode", typical(episodes, g)))
        columns.append(_mean(records, group, "skill", "ballistic_skill", g))
        columns.append(Column(group, "match", match(g)))
        columns.append(_mean(records, group, "force cosine", "force_cosine", g))
    return _table(records, records.lines, columns)


def drift_table(records: Records) -> Table:
    """Energy drift by horizon: median episode, worst episode, share of episodes above 1."""

    def at(metric: str, steps: int, choose: Choice) -> Callable[[Line], Cell]:
        return lambda line: chosen_cell(records.pick(line, metric, horizon=steps), choose)

    columns = []
    for steps in records.horizons:
        group = f"{steps:,} steps"
        columns.append(Column(group, "median", at("energy_drift_median", steps, median)))
        columns.append(Column(group, "worst", at("energy_drift_worst", steps, max)))
        if "energy_drift_over_one" in records.metrics:
            columns.append(Column(group, "share > 1", at("energy_drift_over_one", steps, _average)))
    if "valid_time" in records.metrics:
        last = records.horizons[-1]
        columns.append(Column("valid", "time, s", at("valid_time", last, median)))
    if "retrace_nmse" in records.metrics:
        columns.append(_mean(records, "there and back", "nMSE", "retrace_nmse"))
    lines = [line for line in records.lines if records.pick(line, "energy_drift_median")]
    return _table(records, lines, columns)


def perception_table(records: Records) -> Table | None:
    """What the perceived state was worth, if anything was recorded."""
    found = [metric for metric in PERCEPTION if metric in records.metrics]
    columns = [_mean(records, "", PERCEPTION[metric], metric) for metric in found]
    lines = [line for line in records.lines if any(records.pick(line, m) for m in found)]
    return _table(records, lines, columns) if columns else None


def other_table(records: Records) -> Table | None:
    """Every metric that no other table has, if there is one."""
    others = {
        (row["metric"], row["coupling"], row["horizon"])
        for row in records.rows
        if row["metric"] not in SHOWN
    }
    columns = []
    for metric, g, steps in sorted(others, key=lambda key: (key[0], key[1] or 0, key[2] or 0)):
        at = "" if g is None else f"G = {g:g} "
        until = "" if steps is None else f"{steps:,} steps"
        columns.append(_mean(records, metric, at + until or "value", metric, g, steps))
    return _table(records, records.lines, columns) if columns else None


def verdict_table(records: Records) -> Table:
    """Each factored head against the twin of its rung, seed by seed."""
    rows = []
    for lines in records.rungs.values():
        twin = next((line for line in lines if line.head == TWIN), None)
        mine = [line for line in lines if line.head.startswith("factored")]
        for k, line in enumerate(mine):
            cells = _against(records, line, twin)
            rows.append(_row(records, line, cells, len(mine) if k == 0 else 0))
    labels = ["its nMSE", "twin's nMSE", "twin / head", "twin worse", "verdict"]
    return Table([], labels, rows)


def verdict(records: Records, line: Line, twin: Line | None) -> tuple[str, str]:
    """(``holds``, ``does not hold`` or ``no verdict``, why): inverts, its twin worse each seed."""
    g = records.coupling
    skill = records.pick(line, "ballistic_skill", coupling=g)
    error = records.pick(line, "inversion_nmse", coupling=g)
    if error is None or skill is None:
        return NO_VERDICT, "not measured"
    if bad := {status for _, status in (*error.bad, *skill.bad)}:
        return FAILS if bad == {"failed"} else NO_VERDICT, error.words or skill.words
    if max(skill.values) >= SKILL_BAR:
        return FAILS, f"does not invert: skill up to {number(max(skill.values))}"
    other = records.pick(twin, "inversion_nmse", coupling=g) if twin else None
    if other is None:
        return NO_VERDICT, "inverts; no twin was run"
    pairs = paired(error, other)
    hits = sum(mine < its for mine, its in pairs)
    if hits < len(pairs):
        return FAILS, f"inverts, but the twin is worse on {hits}/{len(pairs)} seeds only"
    if other.bad:
        return HOLDS, f"inverts; its twin: {other.words}"
    return HOLDS, "inverts; the twin is worse on every seed"


def _against(records: Records, line: Line, twin: Line | None) -> list[Cell]:
    error = records.pick(line, "inversion_nmse", coupling=records.coupling)
    other = records.pick(twin, "inversion_nmse", coupling=records.coupling) if twin else None
    pairs = paired(error, other) if error and other else []
    ratio = worse = NOT_MEASURED
    if pairs:
        hits = sum(mine < its for mine, its in pairs)
        worse = Cell(f"{hits}/{len(pairs)} seeds")
        if total := sum(mine for mine, _ in pairs):
            times = sum(its for _, its in pairs) / total
            shown = f"{times:,.0f}" if 100 <= times < 1e6 else number(times)
            ratio = Cell(f"{shown} times", times)
    return [mean_cell(error), mean_cell(other), ratio, worse, verdict_cell(records, line, twin)]


def verdict_cell(records: Records, line: Line, twin: Line | None) -> Cell:
    """The verdict in colour, and why in words."""
    word, why = verdict(records, line, twin)
    return Cell(why, None, (), ((word, TONES[word]),), "said")


def _status_cell(records: Records, line: Line) -> Cell:
    seeds, marks = records.seeds(line), []
    for status, metrics in sorted(records.troubles(line).items()):
        hit = {seed for found in metrics.values() for seed in found}
        marks.append((f"{status} {len(hit)}/{len(seeds)}", "bad"))
    marks = marks or [(f"ok {len(seeds)}/{len(seeds)}", "good")]
    stale = [("stale", "bad")] if records.is_stale(line) else []
    return Cell("", None, (), tuple(marks + stale))


def _mean(
    records: Records,
    group: str,
    label: str,
    metric: str,
    g: float | None = None,
    steps: int | None = None,
) -> Column:
    return Column(
        group,
        label,
        lambda line: mean_cell(records.pick(line, metric, coupling=g, horizon=steps)),
    )


def _table(records: Records, lines: Sequence[Line], columns: Sequence[Column]) -> Table:
    rows = []
    for rung in records.rungs.values():
        group = [line for line in rung if line in lines]
        for k, line in enumerate(group):
            cells = [column.cell(line) for column in columns]
            rows.append(_row(records, line, cells, len(group) if k == 0 else 0))
    named = any(column.group for column in columns)
    groups = [
        (name, len(list(group))) for name, group in groupby(columns, key=lambda each: each.group)
    ]
    return Table(groups if named else [], [column.label for column in columns], rows)


def _row(records: Records, line: Line, cells: list[Cell], opens: int) -> TableRow:
    return TableRow(line, style(line.head, records.heads)[0], opens, cells)


def _average(values: Sequence[float]) -> float:
    return sum(values) / len(values)
