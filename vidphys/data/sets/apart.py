"""What data sets in Arrow, Parquet and HDF5 hold, which child processes read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vidphys.data.formats import bounded
from vidphys.data.formats.child import Child
from vidphys.data.formats.foreign import MEMORY, SECONDS, received
from vidphys.errors import InputError

Kind = Literal["arrow", "parquet"]
OPEN = 8  # tables that are kept
RANGES = 2000  # of rows that a child is asked for, in its arguments
ADVICE = "save it anew, or as CSV and video files"


@dataclass(frozen=True)
class Rows:
    """The rows of a file, without pictures and films.

    Args:
        count: of them.
        kinds: what each column is: numbers, and times and words too; video, picture, pictures (a
            list in each row), or nothing that is known.
        columns: of numbers, a row each, in an array or a list; of a video where it says that it
            lies, of pictures how many there are.
    """

    count: int
    kinds: dict[str, str]
    columns: dict[str, np.ndarray | list[np.ndarray]]

    def values(self, row: int) -> dict[str, Any]:
        """What a row holds in its columns of numbers, without its empty cells."""
        numbers = (name for name in self.columns if self.kinds[name] == "numbers")
        held = {name: self.columns[name][row] for name in numbers}
        return {n: x if np.ndim(x) else x.item() for n, x in held.items() if not _empty(x)}


def _empty(value: Any) -> bool:
    return not np.size(value) if np.ndim(value) else bool(value != value or value == "")


def rows_of(path: Path, kind: Kind) -> Rows:
    """The rows of a file.

    Raises:
        InputError: it cannot be read, is too large, or reading takes more than it may.
    """
    return _kept(path, kind, path.stat().st_mtime_ns)


@lru_cache(OPEN)
def _kept(path: Path, kind: Kind, _changed: int) -> Rows:
    limits = (kind, "columns", MEMORY, SECONDS, bounded.MOST_BYTES, bounded.MOST_COLUMNS)
    with Child(path, "rows.py", limits, ["pyarrow"], ADVICE) as child:
        told = child.message()
        held: dict[str, np.ndarray | list[np.ndarray]] = dict(received(child, told))
    for name, shapes in told["ragged"].items():
        stops = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes)])
        flat = np.asarray(held[name])
        parts = zip(pairwise(stops), shapes, strict=True)
        held[name] = [flat[first:stop].reshape(shape) for (first, stop), shape in parts]
    return Rows(told["count"], told["kinds"], held)


def cells_of(path: Path, kind: Kind, column: str, rows: Sequence[int]) -> Iterator[Any]:
    """What lies in some rows of a column of media: bytes, or the name of the file that they lie in.

    Raises:
        InputError: see :func:`rows_of`.
    """
    ranges = _ranges(rows)
    for some in ranges:
        limits = (kind, "cells", MEMORY, SECONDS, column, *(f"{a}-{b}" for a, b in some))
        with Child(path, "rows.py", limits, ["pyarrow"], ADVICE) as child:
            while not (said := child.message()).get("end"):
                if "size" not in said:
                    yield said["path"]
                    continue
                bounded.require_room((said["size"],), 1, f"a cell of {column}")
                data = bytearray(said["size"])
                child.fill(memoryview(data))
                yield bytes(data)


def _ranges(rows: Sequence[int]) -> list[list[tuple[int, int]]]:
    """Rows as ranges, rising in each of the lists."""
    lists: list[list[tuple[int, int]]] = [[]]
    for row in rows:
        last = lists[-1]
        if last and last[-1][1] == row:
            last[-1] = last[-1][0], row + 1
        elif last and (len(last) == RANGES or row < last[-1][1]):
            lists.append([(row, row + 1)])
        else:
            last.append((row, row + 1))
    return lists if rows else []


@dataclass(frozen=True)
class Group:
    """A clip of an HDF5 file.

    Args:
        name: of it.
        frames: the path of its frames in the file, and their ``shape`` and ``dtype``.
        arrays: beside them.
        facts: single numbers and words.
    """

    name: str
    frames: str
    shape: tuple[int, ...]
    dtype: np.dtype
    arrays: dict[str, np.ndarray]
    facts: dict[str, Any]


def groups_of(path: Path, names: Sequence[str]) -> Iterator[Group]:
    """The clips of an HDF5 file.

    Args:
        path: of the file.
        names: that frames may have.

    Raises:
        InputError: see :func:`rows_of`.
    """
    limits = ("clips", MEMORY, SECONDS, bounded.MOST_BYTES, bounded.MOST_MEMBERS, *names)
    with Child(path, "hdf5.py", limits, ["h5py"], ADVICE) as child:
        size = 0
        for _ in range(child.message()["count"]):
            told = child.message()
            arrays = received(child, told, size)
            size += sum(x.nbytes for x in arrays.values())
            about = tuple(told["shape"]), np.dtype(told["dtype"])
            yield Group(told["name"], told["frames"], *about, arrays, told["facts"])


def frames_of(path: Path, name: str, shape: Sequence[int]) -> Iterator[np.ndarray]:
    """The frames of a clip of an HDF5 file, bytes each.

    Args:
        path: of the file.
        name: of the frames therein.
        shape: of all of them.

    Raises:
        InputError: see :func:`rows_of`; the clip is another than it was.
    """
    count = 0
    with Child(path, "hdf5.py", ("frames", MEMORY, SECONDS, name), ["h5py"], ADVICE) as child:
        while count < shape[0]:
            some = child.message()["count"]
            if not 0 < some <= shape[0] - count:
                raise InputError(f"{some} more frames after {count} of {shape[0]}; {ADVICE}")
            for _ in range(some):
                frame = np.empty(tuple(shape[1:]), np.uint8)
                child.fill(frame.reshape(-1).data)
                yield frame
            count += some
