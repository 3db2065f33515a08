"""Tracks in tables: texts of any dialect, workbooks, Parquet, and arrays of NPZ or NPY.

A table has a row for each time (``t, x1, y1, x2, ...``; ``u1, v1, ...`` in pixels) or for each time
and body (``t, body, x, y``); an NPZ has ``positions`` or ``pixels`` of ``(t, n, d)`` or
``(e, t, n, d)``, and ``times`` or ``dt`` in seconds. An empty cell says that a body was not seen.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np

from vidphys.data.formats.base import Recording, Unit
from vidphys.data.formats.bounded import MOST_MEMBERS, reading, require_room
from vidphys.data.formats.foreign import read_apart
from vidphys.data.formats.rows import recording_of
from vidphys.data.formats.runs import stacked
from vidphys.data.formats.text import Sheet, decoded, read_sheet
from vidphys.data.formats.unnamed import named
from vidphys.errors import InputError

NAMES = ("positions", "q", "tracks", "pixels")
BESIDE = ("times", "dt", "mass", "coupling")
BYTES = 8  # of a number as it is held


def read_text(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Numbers between commas, semicolons, tabs or blanks, under names or none."""
    table, notes = _columns(_text(path))
    return recording_of(table, columns, interval, notes, path.stem)


def text_table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a text."""
    return _columns(_text(path))[0]


def _text(path: Path) -> Sheet:
    return read_sheet(decoded(path).splitlines())


def read_workbook(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The sheet with most numbers of a spreadsheet program's file, as the text that it would be."""
    table, notes = _columns(_workbook(path))
    return recording_of(table, columns, interval, notes, path.stem)


def workbook_table(path: Path) -> dict[str, np.ndarray]:
    """The columns of that sheet."""
    return _columns(_workbook(path))[0]


def _workbook(path: Path) -> Sheet:
    if importlib.util.find_spec("python_calamine") is None:
        raise InputError("reading workbooks needs calamine: pip install 'vidphys[excel]'")
    return read_sheet(read_apart(path, "workbook", ["python_calamine"])["lines"].tolist())


def _columns(sheet: Sheet) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The columns of a text, and how they were read."""
    table, notes = named(sheet.names, sheet.labels, sheet.columns)
    if sheet.body is not None:
        table["body"] = sheet.body
        return table, (*sheet.notes, *notes)
    table, runs = stacked(table)
    return table, (*sheet.notes, *notes, *runs)


def read_parquet(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The columns of a Parquet file."""
    return recording_of(parquet_table(path), columns, interval, called=path.stem)


def parquet_table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a Parquet file."""
    return read_apart(path, "parquet", ["pyarrow"])


def read_arrays(path: Path, _columns: Mapping[str, str], interval: float | None) -> Recording:
    """The arrays of an NPZ file."""
    with reading("an npz file of numbers"):
        arrays = _arrays(path)
    name = next(name for name in NAMES if name in arrays)
    step = float(arrays["dt"].item()) if "dt" in arrays else interval
    found = _placed(np.asarray(arrays[name], float), name, step)
    q, times = found.positions, found.times
    if "times" in arrays:
        times = np.broadcast_to(np.asarray(arrays["times"], float), q.shape[:2]).copy()
    mass = np.broadcast_to(arrays.get("mass", np.ones(1)), (q.shape[0], q.shape[2]))
    coupling = arrays.get("coupling")
    if coupling is not None:
        coupling = np.broadcast_to(np.asarray(coupling, float), len(q)).copy()
    return replace(found, times=times, mass=np.array(mass, float), coupling=coupling)


def _placed(held: np.ndarray, name: str, step: float | None) -> Recording:
    """Places ``(t, n, d)`` or ``(e, t, n, d)``, with so many seconds between frames."""
    q = held[None] if held.ndim == 3 else held
    if q.ndim != 4:
        raise InputError(f"'{name}' must be (t, n, d) or (e, t, n, d), got {held.shape}")
    if not q.size:
        raise InputError(f"'{name}' {held.shape} holds nothing")
    times = None
    if step is not None and step > 0:
        times = np.tile(np.arange(q.shape[1]) * step, (len(q), 1))
    unit: Unit = "pixels" if name == "pixels" else "world"
    length = "px" if name == "pixels" else ""
    return Recording(q, times, unit, notes=(f"array '{name}' {held.shape}",), length=length)


def read_array(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The array of an NPY file: columns of a table ``(rows, k)``, or places of bodies."""
    with reading("an npy file of numbers"):
        held = np.load(path, mmap_mode="r", allow_pickle=False)
    require_room(held.shape, BYTES, "it")
    if held.dtype == np.uint8:
        raise InputError("holds bytes, as frames do; numpy.savez(NAME, frames=..., fps=...) them")
    if held.dtype.kind not in "fiub":
        raise InputError(f"holds {held.dtype}, which are no numbers")
    if held.ndim < 3:
        table, notes = named((), (), list(np.array(held, float).reshape(len(held), -1).T))
        return recording_of(table, columns, interval, notes, path.stem)
    return _placed(np.array(held, float), "array", interval)


def arrays_table(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file that have a number for each frame of its places."""
    with reading("an npz file of numbers"):
        held = headers_of(path)
        frames = next((shape[-3:-2] for name, (shape, _) in held.items() if name in NAMES), ())
        return numbers_of(path, frames)


def numbers_of(path: Path, frames: tuple[int, ...]) -> dict[str, np.ndarray]:
    """The arrays of an NPZ that have a number for each frame, of so many."""
    held = headers_of(path).items()
    return arrays_of(path, [n for n, (shape, d) in held if shape == frames and d.kind in "fiub"])


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays that are taken.

    Raises:
        InputError: not one array of places; see :func:`arrays_of`.
    """
    held = headers_of(path)
    found = [name for name in NAMES if name in held]
    if len(found) != 1:
        shapes = ", ".join(f"{name} {shape}" for name, (shape, _) in list(held.items())[:20])
        raise InputError(f"has {shapes or 'nothing'}; needs either positions or pixels")
    return arrays_of(path, [name for name in (*found, *BESIDE) if name in held])


def arrays_of(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Some arrays of an NPZ, each held to its header before it is read.

    Raises:
        InputError: one that is too large, or holds no numbers.
    """
    held = headers_of(path)
    for name in names:
        shape, dtype = held[name]
        if dtype.kind not in "fiub":
            raise InputError(f"'{name}' holds {dtype}, which are no numbers")
        require_room(shape, max(BYTES, dtype.itemsize), f"'{name}'")
    with np.load(path, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in names}


def headers_of(path: Path) -> dict[str, tuple[tuple[int, ...], np.dtype]]:
    """Shape and type of every array of an NPZ, by its name.

    Raises:
        InputError: there are too many.
    """
    with ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > MOST_MEMBERS:
            raise InputError(f"{len(members)} arrays, more than {MOST_MEMBERS}")
        return {m.filename.removesuffix(".npy"): _header(archive, m.filename) for m in members}


def _header(archive: ZipFile, member: str) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of an array in an archive."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        if version == (1, 0):
            shape, _, dtype = np.lib.format.read_array_header_1_0(file)
        else:
            shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    return shape, dtype
