"""Tracks in tables: texts of any dialect, Parquet, and arrays of NPZ.

A table has a row for each time (``t, x1, y1, x2, ...``; ``u1, v1, ...`` in pixels) or for each time
and body (``t, body, x, y``); an NPZ has ``positions`` or ``pixels`` of ``(t, n, d)`` or
``(e, t, n, d)``, and ``times`` or ``dt`` in seconds. An empty cell says that a body was not seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from vidphys.data.formats.base import Recording, Unit
from vidphys.data.formats.rows import recording_of
from vidphys.data.formats.text import read_sheet
from vidphys.data.formats.unnamed import named
from vidphys.errors import InputError

NAMES = ("positions", "q", "tracks", "pixels")


def read_text(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Numbers between commas, semicolons, tabs or blanks, under names or none."""
    sheet = read_sheet(path)
    table, notes = named(sheet.names, sheet.labels, sheet.columns)
    if sheet.body is not None:
        table["body"] = sheet.body
    return recording_of(table, columns, interval, (*sheet.notes, *notes), path.stem)


def read_parquet(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The columns of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"not a table ({str(error).splitlines()[0]})") from error
    held = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
    return recording_of(held, columns, interval, called=path.stem)


def read_arrays(path: Path, _columns: Mapping[str, str], interval: float | None) -> Recording:
    """The arrays of an NPZ file."""
    try:
        with np.load(path) as held:
            arrays = {name: held[name] for name in held.files}
    except (OSError, EOFError, ValueError, BadZipFile) as error:
        raise InputError(f"not an npz file of numbers ({error})") from error
    found = [name for name in NAMES if name in arrays]
    if len(found) != 1:
        shapes = ", ".join(f"{name} {x.shape}" for name, x in arrays.items())
        raise InputError(f"has {shapes or 'nothing'}; needs either positions or pixels")
    name = found[0]
    q = np.asarray(arrays[name], float)
    if q.ndim == 3:
        q = q[None]
    if q.ndim != 4:
        raise InputError(f"'{name}' must be (t, n, d) or (e, t, n, d), got {arrays[name].shape}")
    step = float(arrays["dt"]) if "dt" in arrays else interval
    times = None
    if step is not None and step > 0:
        times = np.tile(np.arange(q.shape[1]) * step, (len(q), 1))
    if "times" in arrays:
        times = np.broadcast_to(np.asarray(arrays["times"], float), q.shape[:2]).copy()
    mass = np.broadcast_to(arrays.get("mass", np.ones(1)), (q.shape[0], q.shape[2]))
    coupling = arrays.get("coupling")
    if coupling is not None:
        coupling = np.broadcast_to(np.asarray(coupling, float), len(q)).copy()
    unit: Unit = "pixels" if name == "pixels" else "world"
    notes = (f"array '{name}' {arrays[name].shape}",)
    length = "px" if name == "pixels" else ""
    return Recording(q, times, unit, np.array(mass, float), coupling, notes, length)
