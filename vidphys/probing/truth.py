"""What is known of one clip: columns with a value for each frame, from which targets are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from vidphys.errors import InputError


@dataclass(frozen=True)
class Truth:
    """Columns of one clip, a row for each frame.

    Args:
        times: seconds of each frame, ``(t,)``.
        columns: by name, ``(t,)`` each: numbers (NaN where not known) or words. Of body 1, 2, ...
            they are called as in :func:`vidphys.data.rendered.truth_of`: ``x1``, ``vy2``, ``m3``.
    """

    times: np.ndarray
    columns: Mapping[str, np.ndarray]

    def column(self, name: str) -> np.ndarray:
        """One column, ``(t,)``.

        Raises:
            ValueError: there is none of this name.
        """
        if name not in self.columns:
            raise ValueError(f"no column {name}; there are {', '.join(self.columns) or 'none'}")
        return self.columns[name]

    def has(self, *stems: str) -> bool:
        """Whether the first body has a column of each stem."""
        return all(f"{stem}1" in self.columns for stem in stems)

    def of_bodies(self, *stems: str) -> np.ndarray:
        """Columns of every body, ``(t, n, stems)``.

        Args:
            stems: names without the number of the body, such as ``x`` and ``y``.

        Raises:
            ValueError: a body's column is missing.

        Example:
            >>> places = {"x1": np.array([0.0, 1.0]), "x2": np.array([2.0, 3.0])}
            >>> truth = Truth(np.arange(2.0), places)
            >>> truth.of_bodies("x").tolist()
            [[[0.0], [2.0]], [[1.0], [3.0]]]
        """
        count = 1
        while f"{stems[0]}{count + 1}" in self.columns:
            count += 1
        return np.stack(
            [
                np.stack([self.column(f"{stem}{n + 1}").astype(float) for stem in stems], -1)
                for n in range(count)
            ],
            1,
        )


@dataclass(frozen=True)
class Track:
    """Where the bodies of several clips are, those of a clip together and in order of time.

    Args:
        positions: ``(e, n, 2)``, world units; NaN where not known.
        times: seconds, ``(e,)``.
    """

    positions: np.ndarray
    times: np.ndarray


def read_truth(path: Path, rows: np.ndarray, times: np.ndarray) -> Truth:
    """The columns of a table, Parquet or CSV, a row for each frame of the clip's file.

    Args:
        path: the table.
        rows: numbers of the frames that are wanted, ``(t,)``.
        times: seconds of these, ``(t,)``.

    Raises:
        InputError: not such a table, or one with fewer rows than the clip has frames.
    """
    try:
        csv = path.suffix.lower() == ".csv"
        table = pyarrow.csv.read_csv(path) if csv else pyarrow.parquet.read_table(path)
    except (OSError, pa.ArrowException) as error:
        said = " ".join(str(error).split())
        raise InputError(f"{path}: no table of targets ({said}); give CSV or Parquet") from error
    if len(table) <= int(rows.max()):
        raise InputError(
            f"{path}: {len(table)} rows, but frame {int(rows.max())} of the clip is asked for; a "
            "table of targets has a row for each frame"
        )
    columns = {name: _values(table[name]) for name in table.column_names}
    return Truth(times, {name: values[rows] for name, values in columns.items()})


def _values(column: Any) -> np.ndarray:
    """Numbers as floats, NaN where empty; anything else as it is."""
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind):
        return column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    return np.asarray(column.to_pylist(), dtype=object)
