"""A measured point: what was set, what it cost, how wrong it was, and against what."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import pyarrow as pa

from vidphys.errors import InputError
from vidphys.runs.records import read_table, write_table

Setting = str | int | float | bool | None
CPU_CLOCK, WALL_CLOCK = "cpu", "wall"


@dataclass(frozen=True)
class Point:
    """One configuration, measured.

    Args:
        front: the family of choices that it belongs to.
        task: what was done; only points of one front and task compete.
        configuration: what was set, by name.
        cost_name: of the cost, unit included, such as ``ms_per_clip``.
        cost, cost_low, cost_high: median and quartiles over the repeats, by ``clock``.
        clock: ``cpu`` (time of the process) or ``wall``.
        wall: median by the wall clock, in the unit of the cost.
        repeats: timed calls, interleaved with those of the other points.
        warmup_seconds: of the first call, by the wall clock; in none of the others.
        peak_bytes: resident memory above that at the start of a call; ``None`` where not known.
        units: what does not depend on the machine: ``force_evaluations``, ``multiply_adds``,
            ``tokens``, ``bytes``, each per unit of the cost's work.
        error_name: of the error.
        error: against the reference; ``None`` where the result was not finite.
        errors: further errors by name.
        reference: what the error is measured against.
        seed, device, dtype, threads: under which it was measured.
    """

    front: str
    task: str
    configuration: dict[str, Setting]
    cost_name: str
    cost: float
    cost_low: float
    cost_high: float
    clock: str
    wall: float
    repeats: int
    warmup_seconds: float
    peak_bytes: int | None
    error_name: str
    error: float | None
    reference: str
    seed: int
    device: str
    dtype: str
    threads: int
    units: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """The same configuration of another run has the same key."""
        about = [self.front, self.task, self.configuration, self.device, self.dtype, self.threads]
        return json.dumps(about, sort_keys=True)

    @property
    def label(self) -> str:
        """The configuration in a line."""
        return ", ".join(f"{name} {value}" for name, value in self.configuration.items())

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Point:
        """Inverse of ``dataclasses.asdict``.

        Raises:
            InputError: fields are missing or unknown, or a cost is no number.
        """
        names = {f.name for f in fields(cls)}
        if set(record) != names:
            odd = ", ".join(sorted(names ^ set(record)))
            raise InputError(f"measured point: missing or unknown fields {odd}; measure again")
        point = cls(**record)
        if not math.isfinite(point.cost):
            raise InputError(f"measured point {point.label}: its cost is {point.cost}")
        return point


_PLAIN = {str: pa.string(), int: pa.int64(), float: pa.float64()}
_NESTED = ("configuration", "units", "errors")
_KINDS = {
    "front": str,
    "task": str,
    "cost_name": str,
    "clock": str,
    "repeats": int,
    "peak_bytes": int,
    "error_name": str,
    "reference": str,
    "seed": int,
    "device": str,
    "dtype": str,
    "threads": int,
}
SCHEMA = pa.schema(
    [
        (f.name, pa.string() if f.name in _NESTED else _PLAIN[_KINDS.get(f.name, float)])
        for f in fields(Point)
    ]
)


def write_points(path: Path, points: Sequence[Point]) -> None:
    """Write points as Parquet, a row each; nested fields as JSON text."""
    rows = []
    for point in points:
        row = asdict(point)
        rows.append({**row, **{name: json.dumps(row[name], sort_keys=True) for name in _NESTED}})
    write_table(path, pa.Table.from_pylist(rows, SCHEMA))


def read_points(path: Path) -> list[Point]:
    """Points as :func:`write_points` wrote them."""
    rows = read_table(path).to_pylist()
    return [
        Point.from_dict({**row, **{name: json.loads(row[name]) for name in _NESTED}})
        for row in rows
    ]
