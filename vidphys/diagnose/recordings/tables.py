"""Recorded tracks from a user's file: CSV, Parquet, NPZ, or a text table of a motion capture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vidphys.diagnose.recordings.columns import Columns, detect_columns
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError

SUFFIXES = (".csv", ".parquet", ".npz", ".txt")
PREFIX = ("trial", "t")  # columns that motion-capture tables have before those that they name


@dataclass(frozen=True)
class Loaded:
    """Tracks and how the file was understood.

    Args:
        motion: the tracks.
        angles: whether coordinates are angles in radians.
        notes: what was found, a line each.
    """

    motion: Motion
    angles: bool
    notes: tuple[str, ...]


def read_tracks(
    path: Path, columns: Mapping[str, str] | None = None, interval: float | None = None
) -> Loaded:
    """Read tracks.

    Args:
        path: a table with a row for each time (``t, x1, y1, x2, ...``) or for each time and body
            (``t, body, x, y``), or an NPZ with ``positions`` of ``(t, n, d)`` or ``(e, t, n, d)``.
        columns: what some columns are, where their names do not tell.
        interval: seconds between frames, where the file has no times.

    Raises:
        InputError: a file that cannot be read, or that does not hold tracks.

    Example:
        >>> import tempfile
        >>> table = Path(tempfile.mkdtemp()) / 'tracks.csv'
        >>> seconds = np.arange(10)[None] / 30
        >>> write_tracks(table, Motion(np.zeros((1, 10, 1, 2)), seconds, np.ones((1, 1))))
        >>> read_tracks(table).motion.positions.shape  # clips, frames, bodies, space
        (1, 10, 1, 2)
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a table of tracks or a clip")
    if path.suffix not in SUFFIXES:
        raise InputError(f"{path}: not a table that is known ({', '.join(SUFFIXES)})")
    try:
        if path.suffix == ".npz":
            return _from_arrays(path, interval)
        table = _read_table(path)
        found = detect_columns(list(table), columns)
        return _from_table(table, found, interval)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _read_table(path: Path) -> dict[str, np.ndarray]:
    if path.suffix == ".txt":
        return _read_text(path)
    import pyarrow as pa
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path) if path.suffix == ".parquet" else pc.read_csv(path)
    except (pa.ArrowInvalid, OSError) as error:
        raise InputError(f"not a table ({str(error).splitlines()[0]})") from error
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def _read_text(path: Path) -> dict[str, np.ndarray]:
    """Numbers between blanks, under a line that names them or the last of them."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    if not lines or lines[0].strip()[:1] not in ("%", "#"):
        raise InputError("a text table needs a first line like '% x v' that names its columns")
    names = lines[0].strip().lstrip("%#").split()
    values = np.loadtxt(lines[1:], ndmin=2)
    extra = values.shape[1] - len(names)
    if extra == len(PREFIX):
        names = [*PREFIX, *names]
    elif extra != 0:
        raise InputError(f"{values.shape[1]} columns, but {len(names)} names: {', '.join(names)}")
    return dict(zip(names, values.T, strict=True))


def _from_arrays(path: Path, interval: float | None) -> Loaded:
    with np.load(path) as held:
        arrays = {name: held[name] for name in held.files}
    name = next((n for n in ("positions", "q", "tracks") if n in arrays), None)
    if name is None:
        raise InputError(f"no array 'positions' among {', '.join(arrays) or 'none'}")
    q = np.asarray(arrays[name], float)
    if q.ndim == 3:
        q = q[None]
    if q.ndim != 4:
        raise InputError(f"'{name}' must be (t, n, d) or (e, t, n, d), got {arrays[name].shape}")
    if "times" in arrays:
        times = np.broadcast_to(np.asarray(arrays["times"], float), q.shape[:2]).copy()
    else:
        step = float(arrays["dt"]) if "dt" in arrays else interval
        times = np.tile(np.arange(q.shape[1]) * _needed(step), (len(q), 1))
    mass = np.broadcast_to(arrays.get("mass", np.ones(1)), (q.shape[0], q.shape[2]))
    coupling = arrays.get("coupling")
    if coupling is not None:
        coupling = np.broadcast_to(np.asarray(coupling, float), len(q)).copy()
    motion = Motion(q, times, np.array(mass, float), coupling)
    return Loaded(motion, False, (f"array '{name}' {arrays[name].shape}",))


def _needed(interval: float | None) -> float:
    if interval is None or not interval > 0:
        raise InputError("no times in seconds; give the seconds between frames with --interval")
    return interval


def _from_table(
    table: Mapping[str, np.ndarray], columns: Columns, interval: float | None
) -> Loaded:
    times = _times(table, columns, interval)
    clip = table[columns.clip] if columns.clip else np.zeros(len(times))
    flip = np.array([1.0, -1.0]) if columns.pixels else 1.0
    places = [np.stack([_numbers(table, c) for c in body], -1) for body in columns.coordinates]
    if columns.body is not None:
        labels = table[columns.body]
        names = np.unique(labels)
        parts = [_long(times, places[0] * flip, labels, names, clip == c) for c in np.unique(clip)]
    else:
        names = np.arange(len(places))
        whole = np.stack(places, 1) * flip
        parts = [_sorted(times[clip == c], whole[clip == c]) for c in np.unique(clip)]
    motion = _padded(parts)
    mass = _of_bodies(table, columns, names, motion)
    coupling = _of_clips(table, columns.coupling, clip)
    motion = Motion(motion.positions, motion.times, mass, coupling)
    read = ", ".join("/".join(body) for body in columns.coordinates)
    kind = "angles" if columns.angles else "pixels" if columns.pixels else "coordinates"
    notes = (
        f"{kind} {read}; time {columns.time or columns.frame or 'by --interval'}",
        f"{motion.clips} clip(s) of {motion.positions.shape[1]} frames, {motion.bodies} "
        f"bodies in {motion.space} dimension(s), {motion.interval:.4g} s between frames",
    )
    return Loaded(motion, columns.angles, notes)


def _numbers(table: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    try:
        return np.asarray(table[name], float)
    except (TypeError, ValueError) as error:
        raise InputError(f"column {name}: not numbers ({error})") from error


def _times(table: Mapping[str, np.ndarray], columns: Columns, interval: float | None) -> np.ndarray:
    if columns.time is not None:
        return _numbers(table, columns.time)
    if columns.frame is not None:
        return _numbers(table, columns.frame) * _needed(interval)
    if columns.body is not None or columns.clip is not None:
        raise InputError("no column of times; name it t or frame, or give --columns time=NAME")
    return np.arange(len(next(iter(table.values())))) * _needed(interval)


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


def _padded(parts: list[tuple[np.ndarray, np.ndarray]]) -> Motion:
    """Clips of one length: shorter ones end in frames in which nothing was seen."""
    longest = max(len(times) for times, _ in parts)
    usual = float(np.median(np.concatenate([np.diff(times) for times, _ in parts])))
    times, places = [], []
    for t, q in parts:
        rest = longest - len(t)
        times.append(np.concatenate([t, t[-1] + usual * np.arange(1, rest + 1)]))
        places.append(np.concatenate([q, np.full((rest, *q.shape[1:]), np.nan)]))
    positions = np.stack(places)
    return Motion(positions, np.stack(times), np.ones((len(parts), positions.shape[2])))


def _of_bodies(
    table: Mapping[str, np.ndarray], columns: Columns, names: np.ndarray, motion: Motion
) -> np.ndarray:
    """Masses, one for each body, where the table has them."""
    if columns.mass is None or columns.body is None:
        return motion.mass
    mass, labels = _numbers(table, columns.mass), table[columns.body]
    own = np.array([np.median(mass[labels == name]) for name in names])
    return np.tile(own, (motion.clips, 1))


def _of_clips(
    table: Mapping[str, np.ndarray], name: str | None, clip: np.ndarray
) -> np.ndarray | None:
    if name is None:
        return None
    values = _numbers(table, name)
    return np.array([np.median(values[clip == c]) for c in np.unique(clip)])


def write_tracks(path: Path, motion: Motion) -> None:
    """Write the tracks of one clip as a table that :func:`read_tracks` reads."""
    import pyarrow as pa
    import pyarrow.csv as pc

    columns = {"t": motion.times[0]}
    for body in range(motion.bodies):
        for axis in range(motion.space):
            columns[f"{'xyz'[axis]}{body + 1}"] = motion.positions[0, :, body, axis]
    pc.write_csv(pa.table(columns), path)
