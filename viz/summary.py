"""Records to the few numbers that a reader needs: one line of the ladder at a time.

A record is one row of ``records.parquet`` as a dict. A *line* is (grounding, readout, head): what
the ladder compares; its records differ by seed, metric, coupling and horizon.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

Row = Mapping[str, Any]
TWIN = "unstructured"
GATED, GATE = "regime_match_gated", "gate not passed"
SKILL_BAR = 0.5  # error over the zero-force predictor's: below it counts as inversion
NON_NEGATIVE = ("nmse", "drift", "skill", "distance", "residual", "growth")
_GROUNDINGS = (
    "oracle",
    "renderer",
    "cnn-supervised",
    "cnn-discovered",
    "jepa",
    "jepa-centroid",
    "jepa-exact",
    "rgb-tracked",
    "anonymous-hand",
    "anonymous-tracker",
    "anonymous-tracker-twostage",
    "anonymous-slots",
    "hiera",
    "i3d",
    "dino-tiny",
    "videomae-tiny",
    "vjepa2-tiny",
    "dinov2",
    "videomae",
    "composed",
    "composed-hiera",
)
_READOUTS = ("none", "differencing", "shooting")
_HEADS = ("factored", "factored-radial", "factored-learned-kinetic", "symplectic", TWIN)


@dataclass(frozen=True, order=True)
class Line:
    """What the ladder compares: a grounding read by a readout and rolled by a head."""

    grounding: str
    readout: str
    head: str

    @property
    def rung(self) -> str:
        """The part that a head and its twin share, in words."""
        return self.grounding if self.readout == "none" else f"{self.grounding} · {self.readout}"


@dataclass(frozen=True)
class Summary:
    """One metric of one line over the seeds.

    Args:
        seeds: seeds whose value counts, ascending.
        values: their values.
        bad: (seed, status) of the others: failed, invalid, void or skipped.
        nonfinite: non-finite episodes, all seeds together.
        episodes: episodes, all seeds together.
        clip: whether the metric cannot be negative, so that an interval's lower end is cut at 0.
        metric: its name.
    """

    seeds: tuple[int, ...]
    values: tuple[float, ...]
    bad: tuple[tuple[int, str], ...]
    nonfinite: int
    episodes: int
    clip: bool
    metric: str = ""

    @property
    def mean(self) -> float | None:
        """Mean over the seeds that count; None if none does."""
        return sum(self.values) / len(self.values) if self.values else None

    @property
    def interval(self) -> tuple[float, float, str] | None:
        """(low, high, kind): 95 % normal approximation from five seeds on, else the range."""
        n, mean = len(self.values), self.mean
        if mean is None or n < 2:
            return None
        if n < 5:
            return min(self.values), max(self.values), "range"
        spread = math.sqrt(sum((v - mean) ** 2 for v in self.values) / (n - 1))
        half = 1.96 * spread / math.sqrt(n)
        low = max(0.0, mean - half) if self.clip else mean - half
        return low, mean + half, "95 %"

    @property
    def words(self) -> str:
        """The statuses of the seeds that do not count, for example ``failed 2/3``."""
        total = len(self.values) + len(self.bad)
        names = sorted({status for _, status in self.bad})
        return ", ".join(f"{s} {sum(b == s for _, b in self.bad)}/{total}" for s in names)


class Records:
    """All records of a run, found by line and metric.

    Args:
        rows: records as dicts with the columns of ``records.parquet``.

    Raises:
        ValueError: there are none, or a column is missing.
    """

    def __init__(self, rows: Iterable[Row]) -> None:
        self.rows = list(rows)
        if not self.rows:
            raise ValueError("records: expected at least one row, got none; run a cell first")
        needed = {"grounding", "readout", "head", "seed", "metric", "coupling", "horizon", "value"}
        missing = sorted((needed | {"status"}) - set(self.rows[0]))
        if missing:
            raise ValueError(f"records: the columns {', '.join(missing)} are missing")
        self._found: dict[tuple[Line, str], list[Row]] = {}
        self.rows = _gated(self.rows)
        for row in self.rows:
            line = Line(row["grounding"], row["readout"], row["head"])
            self._found.setdefault((line, row["metric"]), []).append(row)

    @cached_property
    def lines(self) -> list[Line]:
        """Every line, in the ladder's order (unknown names after the known, alphabetically)."""
        return sorted({line for line, _ in self._found}, key=_place)

    @property
    def rungs(self) -> dict[str, list[Line]]:
        """Lines by rung, so that a head stands beside its twin."""
        rungs: dict[str, list[Line]] = {}
        for line in self.lines:
            rungs.setdefault(line.rung, []).append(line)
        return rungs

    @cached_property
    def heads(self) -> list[str]:
        """Every head, in the ladder's order."""
        return sorted({line.head for line in self.lines}, key=lambda h: _index(_HEADS, h))

    @cached_property
    def couplings(self) -> list[float]:
        """The couplings that inversion was tested at, weakest first."""
        found = {row["coupling"] for row in self.rows if row["metric"] == "inversion_nmse"}
        return sorted((g for g in found if g is not None), key=abs)

    @property
    def coupling(self) -> float | None:
        """The headline's coupling: -1 where tested, else the strongest."""
        if not self.couplings:
            return None
        return -1.0 if -1.0 in self.couplings else self.couplings[-1]

    @cached_property
    def horizons(self) -> list[int]:
        """The horizons (simulation steps) that drift was measured at."""
        found = {row["horizon"] for row in self.rows if row["metric"] == "energy_drift_median"}
        return sorted(h for h in found if h is not None)

    @property
    def horizon(self) -> int | None:
        """The headline's drift horizon: 2,000 steps, or the longest below."""
        return max((h for h in self.horizons if h <= 2000), default=None)

    def seeds(self, line: Line) -> list[int]:
        """The seeds that a line has any record of."""
        return sorted({int(row["seed"]) for row in self._of(line)})

    def said(self, line: Line, column: str) -> str:
        """What a line's records have in a column, each once; empty where they do not say it."""
        told = [row.get(column) for row in self._of(line)]
        return ", ".join(str(x) for x in dict.fromkeys(told) if x not in (None, ""))

    def is_stale(self, line: Line) -> bool:
        """Whether the code has changed since a number of a line was made."""
        return any(row.get("stale") for row in self._of(line))

    def troubles(self, line: Line) -> dict[str, dict[str, list[int]]]:
        """What has no number that counts: metric to seeds, by status."""
        found: dict[str, dict[str, list[int]]] = {}
        for row in self._of(line):
            if not counts(row) and row["status"] != GATE:
                seeds = found.setdefault(_status(row), {}).setdefault(row["metric"], [])
                if row["seed"] not in seeds:
                    seeds.append(int(row["seed"]))
        return found

    @cached_property
    def metrics(self) -> list[str]:
        """Every metric's name, alphabetically."""
        return sorted({metric for _, metric in self._found})

    def _of(self, line: Line) -> list[Row]:
        return [row for (found, _), rows in self._found.items() if found == line for row in rows]

    def pick(
        self,
        line: Line,
        metric: str,
        *,
        coupling: float | None = None,
        horizon: int | None = None,
    ) -> Summary | None:
        """The metric over the seeds, None if nothing was recorded; None matches everything."""
        rows = [
            row
            for row in self._found.get((line, metric), ())
            if (coupling is None or row["coupling"] == coupling)
            and (horizon is None or row["horizon"] == horizon)
        ]
        return summarise(rows) if rows else None


def _gated(rows: Sequence[Row]) -> list[Row]:
    """The rows; a gated match that has no value because its gate was not passed says that.

    The gate is that a rollout beats the zero-force predictor. Its records say ``invalid``, as they
    do where nothing could be compared; there the plain match has no number either.
    """
    matched = {_place_of(row) for row in rows if row["metric"] == "regime_match" and counts(row)}
    return [
        {**row, "status": GATE}
        if row["metric"] == GATED and row["status"] == "invalid" and _place_of(row) in matched
        else row
        for row in rows
    ]


def _place_of(row: Row) -> tuple[Any, ...]:
    return tuple(row[name] for name in ("grounding", "readout", "head", "seed", "coupling"))


def summarise(rows: Sequence[Row]) -> Summary:
    """Summarise the records of one metric: one row a seed."""
    rows = sorted(rows, key=lambda row: row["seed"])
    good = [row for row in rows if counts(row)]
    metric = rows[0]["metric"]
    return Summary(
        seeds=tuple(int(row["seed"]) for row in good),
        values=tuple(float(row["value"]) for row in good),
        bad=tuple((int(row["seed"]), _status(row)) for row in rows if not counts(row)),
        nonfinite=sum(int(row.get("nonfinite") or 0) for row in rows),
        episodes=sum(int(row.get("episodes") or 0) for row in rows),
        clip=any(word in metric for word in NON_NEGATIVE),
        metric=metric,
    )


def counts(row: Row) -> bool:
    """Whether a record is a number that may be compared."""
    value = row["value"]
    return row["status"] == "ok" and isinstance(value, int | float) and math.isfinite(value)


def median(values: Sequence[float]) -> float | None:
    """The median, None of nothing."""
    if not values:
        return None
    ordered, half = sorted(values), len(values) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2


def one_sided_p(matches: int, trials: int) -> float:
    """Exact binomial probability of so many matches or more at even odds (the study's test)."""
    return sum(math.comb(trials, k) for k in range(matches, trials + 1)) / 2**trials


def paired(head: Summary, twin: Summary) -> list[tuple[float, float]]:
    """Both values on each seed that both have one for."""
    other = dict(zip(twin.seeds, twin.values, strict=True))
    return [(v, other[s]) for s, v in zip(head.seeds, head.values, strict=True) if s in other]


def _status(row: Row) -> str:
    # An "ok" without a number would otherwise vanish from the report.
    return str(row["status"]) if row["status"] != "ok" else "no value"


def _index(order: Sequence[str], name: str) -> tuple[int, str]:
    return (order.index(name), "") if name in order else (len(order), name)


def _rung(name: str) -> tuple[int, str]:
    """A variant comes right after the rung whose name its own begins with."""
    own = [rung for rung in _GROUNDINGS if name == rung or name.startswith(f"{rung}-")]
    base = max(own, key=len, default=name)
    return _index(_GROUNDINGS, base)[0], name.removeprefix(base) if own else name


def _place(line: Line) -> tuple[tuple[int, str], ...]:
    return (
        _rung(line.grounding),
        _index(_READOUTS, line.readout),
        _index(_HEADS, line.head),
    )
