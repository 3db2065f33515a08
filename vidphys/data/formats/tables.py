"""Tracks in tables: CSV, Parquet, arrays of NPZ, and the text of a motion capture.

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
from vidphys.data.formats.columns import Columns, detect_columns
from vidphys.errors import InputError

PREFIX = ("trial", "t")  # columns that motion-capture tables have before those that they name
NAMES = ("positions", "q", "tracks", "pixels")
Table = Mapping[str, np.ndarray]


def read_csv(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Numbers between commas, under a line of names."""
    import pyarrow as pa
    import pyarrow.csv as pc

    try:
        table = pc.read_csv(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"not a table ({str(error).splitlines()[0]})") from error
    return _recording(_arrays(table), columns, interval)


def read_parquet(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The columns of a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"not a table ({str(error).splitlines()[0]})") from error
    return _recording(_arrays(table), columns, interval)


def _arrays(table) -> Table:  # noqa: ANN001 (a table of pyarrow, imported late)
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def is_text(path: Path) -> bool:
    """Whether a text begins with a line that names columns."""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.readline().strip()[:1] in ("%", "#")


def read_text(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Numbers between blanks, under a line that names them or the last of them."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    names = lines[0].strip().lstrip("%#").split()
    values = np.loadtxt(lines[1:], ndmin=2)
    extra = values.shape[1] - len(names)
    if extra == len(PREFIX):
        names = [*PREFIX, *names]
    elif extra != 0:
        raise InputError(f"{values.shape[1]} columns, but {len(names)} names: {', '.join(names)}")
    return _recording(dict(zip(names, values.T, strict=True)), columns, interval)


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
    step = _positive(float(arrays["dt"]) if "dt" in arrays else interval)
    times = None if step is None else np.tile(np.arange(q.shape[1]) * step, (len(q), 1))
    if "times" in arrays:
        times = np.broadcast_to(np.asarray(arrays["times"], float), q.shape[:2]).copy()
    mass = np.broadcast_to(arrays.get("mass", np.ones(1)), (q.shape[0], q.shape[2]))
    coupling = arrays.get("coupling")
    if coupling is not None:
        coupling = np.broadcast_to(np.asarray(coupling, float), len(q)).copy()
    unit: Unit = "pixels" if name == "pixels" else "world"
    notes = (f"array '{name}' {arrays[name].shape}",)
    return Recording(q, times, unit, np.array(mass, float), coupling, notes)


def _recording(table: Table, given: Mapping[str, str], interval: float | None) -> Recording:
    columns = detect_columns(list(table), given)
    order, timed = _order(table, columns, _positive(interval))
    clip = table[columns.clip] if columns.clip else np.zeros(len(order))
    places = [np.stack([_numbers(table, c) for c in body], -1) for body in columns.coordinates]
    if columns.body is not None:
        labels = table[columns.body]
        names = np.unique(labels)
        parts = [_long(order, places[0], labels, names, clip == c) for c in np.unique(clip)]
    else:
        names = np.arange(len(places))
        whole = np.stack(places, 1)
        parts = [_sorted(order[clip == c], whole[clip == c]) for c in np.unique(clip)]
    times, positions = _padded(parts)
    read = ", ".join("/".join(body) for body in columns.coordinates)
    kind = "angles" if columns.angles else "pixels" if columns.pixels else "coordinates"
    return Recording(
        positions,
        times if timed else None,
        "angles" if columns.angles else "pixels" if columns.pixels else "world",
        _of_bodies(table, columns, names, len(parts)),
        _of_clips(table, columns.coupling, clip),
        (f"{kind} {read}; time {columns.time or columns.frame or 'by the interval'}",),
    )


def _positive(interval: float | None) -> float | None:
    return interval if interval is not None and interval > 0 else None


def _numbers(table: Table, name: str) -> np.ndarray:
    try:
        return np.asarray(table[name], float)
    except (TypeError, ValueError) as error:
        raise InputError(f"column {name}: not numbers ({error})") from error


def _order(table: Table, columns: Columns, interval: float | None) -> tuple[np.ndarray, bool]:
    """What rows are in order by, and whether it is seconds."""
    if columns.time is not None:
        return _numbers(table, columns.time), True
    if columns.frame is not None:
        numbers = _numbers(table, columns.frame)
    elif columns.body is not None or columns.clip is not None:
        raise InputError(
            "no column of times; name it t or frame, or say which with `columns` time=NAME"
        )
    else:
        numbers = np.arange(len(next(iter(table.values()))))
    return (numbers, False) if interval is None else (numbers * interval, True)


def _sorted(times: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(times, kind="stable")
    return times[order], places[order]


def _long(
    times: np.ndarray, places: np.ndarray, labels: np.ndarray, names: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A body in each row: one frame for each time, NaN where a body has none."""
    frames, at = np.unique(times[rows], return_inverse=True)
    body = np.searchsorted(names, labels[rows])
    out = np.full((len(frames), len(names), places.shape[-1]), np.nan)
    if len(np.unique(at * len(names) + body)) < len(at):
        raise InputError("a body has two rows at one time; a column may tell clips apart")
    out[at, body] = places[rows]
    return frames, out


def _padded(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Clips of one length: shorter ones end in frames in which nothing was seen."""
    longest = max(len(times) for times, _ in parts)
    steps = np.concatenate([np.diff(times) for times, _ in parts])
    usual = float(np.median(steps)) if len(steps) else 0.0
    times, places = [], []
    for t, q in parts:
        rest = longest - len(t)
        times.append(np.concatenate([t, t[-1] + usual * np.arange(1, rest + 1)]))
        places.append(np.concatenate([q, np.full((rest, *q.shape[1:]), np.nan)]))
    return np.stack(times), np.stack(places)


def _of_bodies(table: Table, columns: Columns, names: np.ndarray, clips: int) -> np.ndarray | None:
    """Masses, one for each body, where the table has them."""
    if columns.mass is None or columns.body is None:
        return None
    mass, labels = _numbers(table, columns.mass), table[columns.body]
    return np.tile(np.array([np.median(mass[labels == name]) for name in names]), (clips, 1))


def _of_clips(table: Table, name: str | None, clip: np.ndarray) -> np.ndarray | None:
    if name is None:
        return None
    values = _numbers(table, name)
    return np.array([np.median(values[clip == c]) for c in np.unique(clip)])
