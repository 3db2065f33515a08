"""Tidy records: one row per number, and the raw per-episode numbers behind each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from registry.tables import read_hashed, write_hashed
from vidphys.errors import InputError
from vidphys.runs.atomic import write_with
from vidphys.summary import FAILED, OK, VOID, Summary

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True)
class Origin:
    """Which run of which model a number belongs to.

    ``supervision`` is what told a perception where bodies are, ``knows`` what it knows of how its
    pictures are drawn, ``context`` the frames that it is shown before the start, t0 included.
    """

    experiment: str
    cell: str
    system: str
    grounding: str
    encoder: str
    binder: str
    readout: str
    head: str
    seed: int
    device: str
    dtype: str
    supervision: str = ""
    knows: str = ""
    context: int | None = None


COUNTS = ("seed", "context")
RECORD_SCHEMA = pa.schema(
    [(f.name, pa.int64() if f.name in COUNTS else pa.string()) for f in fields(Origin)]
    + [
        ("metric", pa.string()),
        ("coupling", pa.float64()),
        ("horizon", pa.int64()),
        ("value", pa.float64()),
        ("status", pa.string()),
        ("episodes", pa.int64()),
        ("nonfinite", pa.int64()),
        ("seconds", pa.float64()),
    ]
)

EPISODE_SCHEMA = pa.schema(
    [
        ("experiment", pa.string()),
        ("cell", pa.string()),
        ("grounding", pa.string()),
        ("readout", pa.string()),
        ("head", pa.string()),
        ("seed", pa.int64()),
        ("episode", pa.int64()),
        ("metric", pa.string()),
        ("coupling", pa.float64()),
        ("horizon", pa.int64()),
        ("value", pa.float64()),
        ("status", pa.string()),
    ]
)


class Recorder:
    """Collects the rows of one cell.

    Example:
        >>> none = dict.fromkeys(('system', 'grounding', 'encoder', 'binder', 'readout'), 'none')
        >>> origin = Origin('mine', 'a/b', head='b', seed=0, device='cpu', dtype='float32', **none)
        >>> recorder = Recorder(origin)
        >>> recorder.add_value('drift', 0.25)
        >>> records, episodes = recorder.tables()
        >>> records.select(['cell', 'metric', 'value', 'status']).to_pylist()
        [{'cell': 'a/b', 'metric': 'drift', 'value': 0.25, 'status': 'ok'}]
    """

    def __init__(self, origin: Origin) -> None:
        self.origin = origin
        self.rows: list[dict[str, object]] = []
        self.episode_rows: list[dict[str, object]] = []

    def reading(self, readout: str) -> Recorder:
        """A recorder of the same cell for another readout, sharing the rows."""
        return self.beside(replace(self.origin, readout=readout))

    def beside(self, origin: Origin) -> Recorder:
        """A recorder of another origin, sharing the rows."""
        other = Recorder(origin)
        other.rows, other.episode_rows = self.rows, self.episode_rows
        return other

    def add(
        self,
        metric: str,
        summary: Summary,
        coupling: float | None = None,
        horizon: int | None = None,
        seconds: float | None = None,
    ) -> None:
        """Record one number with its status and counts; what is not finite has failed."""
        if summary.value is not None and not math.isfinite(summary.value):
            summary = replace(summary, value=None, status=FAILED)
        self.rows.append(
            {
                **asdict(self.origin),
                "metric": metric,
                "coupling": coupling,
                "horizon": horizon,
                "value": summary.value,
                "status": summary.status,
                "episodes": summary.episodes,
                "nonfinite": summary.nonfinite,
                "seconds": seconds,
            }
        )

    def add_value(self, metric: str, value: float, seconds: float | None = None) -> None:
        """Record a plain number that is not a summary of episodes."""
        self.add(metric, Summary(float(value), OK, 0, 0), seconds=seconds)

    def add_episodes(
        self,
        metric: str,
        values: Tensor,
        coupling: float | None = None,
        horizon: int | None = None,
    ) -> None:
        """Record the raw per-episode values ``(b,)``; a non-finite one is null and failed."""
        kept = EPISODE_SCHEMA.names
        origin = {k: v for k, v in asdict(self.origin).items() if k in kept}
        for episode, value in enumerate(values.double().tolist()):
            finite = value == value and abs(value) != float("inf")
            self.episode_rows.append(
                {
                    **origin,
                    "episode": episode,
                    "metric": metric,
                    "coupling": coupling,
                    "horizon": horizon,
                    "value": value if finite else None,
                    "status": OK if finite else FAILED,
                }
            )

    def took(self, seconds: float) -> None:
        """Say how long the work behind the numbers so far took, where that is not yet said."""
        for row in self.rows:
            if row["seconds"] is None:
                row["seconds"] = seconds

    def void(self) -> None:
        """Say of all numbers so far that a positive control failed: they prove nothing."""
        for row in self.rows + self.episode_rows:
            row["status"] = VOID

    def tables(self) -> tuple[pa.Table, pa.Table]:
        """The records and the episodes as Arrow tables."""
        return merged_tables([self])


def merged_tables(recorders: Sequence[Recorder]) -> tuple[pa.Table, pa.Table]:
    """The records and the episodes of several cells as Arrow tables."""
    rows = [row for recorder in recorders for row in recorder.rows]
    episodes = [row for recorder in recorders for row in recorder.episode_rows]
    return (
        pa.Table.from_pylist(rows, RECORD_SCHEMA),
        pa.Table.from_pylist(episodes, EPISODE_SCHEMA),
    )


def write_table(path: Path, table: pa.Table) -> None:
    """Write a Parquet file that is whole or not there, with a hash of its rows."""
    write_with(path, lambda partial: write_hashed(table, partial))


def read_table(path: Path) -> pa.Table:
    """See :func:`registry.tables.read_hashed`.

    Raises:
        InputError: the table is damaged, or a newer vidphys wrote it.
    """
    try:
        return read_hashed(path)
    except ValueError as error:
        raise InputError(str(error)) from error
