"""MATLAB's files: the vectors in them, however deep, that are times and places by their names."""

from __future__ import annotations

import importlib.util
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import reading, require_packed, require_room
from vidphys.data.formats.foreign import read_apart
from vidphys.data.formats.names import meaning_of
from vidphys.data.formats.rows import recording_of
from vidphys.data.formats.shapes import is_rate_of, rising
from vidphys.errors import InputError

HEADER, COMPRESSED = 128, 15  # bytes of the file's header; the kind of an element
NEWEST = b"MATLAB 7.3"  # in the header of a file that is HDF5
LEAST = 8  # samples, from which numbers are a recording and no setting
STEPS = ("dt", "ts", "interval", "sampletime", "deltat")  # seconds between samples
RATES = ("fs", "fps", "rate", "framerate", "samplingrate")  # samples in a second


def read_matlab(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """Vectors of one length, as columns of a table; pieces in cells one after the other."""
    arrays = _arrays(path)
    vectors = _vectors(arrays)
    length, table = _alike(vectors)
    step = interval if interval is not None else _step(arrays)
    table, notes = _named(table)
    if not any(meaning_of(name).kind == "time" for name in table) and step is None:
        raise InputError(f"no vector of times, and no dt; give `interval`; it has {list(table)}")
    left = [name for name in vectors if len(vectors[name]) != length]
    also = (f"of another length, not taken: {', '.join(left)}",) if left else ()
    notes = (f"{length} samples in {_shapes(vectors)}", *notes, *also)
    return recording_of(table, columns, step, notes, path.stem)


def matlab_table(path: Path) -> dict[str, np.ndarray]:
    """The vectors of one length, by the names that they have in the file."""
    return _alike(_vectors(_arrays(path)))[1]


def _arrays(path: Path) -> dict[str, np.ndarray]:
    with path.open("rb") as file:
        newest = NEWEST in file.read(HEADER)
    if newest:
        if importlib.util.find_spec("h5py") is None:
            raise InputError(
                "a MATLAB file of version 7.3, which needs h5py: pip install 'vidphys[sets]'; or "
                "save it with -v7"
            )
        return read_apart(path, "matlab 7.3", ["h5py"])
    with reading("a MATLAB file"):
        _require_room(path)
    return read_apart(path, "matlab", ["scipy"])


def _vectors(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = _continued(_joined({name: x for name, x in arrays.items() if x.size >= LEAST}))
    if not found:
        raise InputError(f"no vectors of {LEAST} numbers or more; it has {_shapes(arrays)}")
    return found


def _require_room(path: Path) -> None:
    """Refuse what would fill the memory when it is unpacked.

    Raises:
        InputError: it would.
    """
    require_room((path.stat().st_size,), 1, "a file")
    data, at = memoryview(path.read_bytes()), HEADER
    order = ">" if data[126:128] == b"MI" else "<"
    while at + 8 <= len(data):
        kind, size = struct.unpack(f"{order}II", data[at : at + 8])
        if kind == COMPRESSED:
            require_packed(data[at + 8 : at + 8 + size])
        at += 8 + size


def _joined(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns ``(samples, channels)``; the pieces of a cell one after the other."""
    pieces: dict[str, list[np.ndarray]] = {}
    for name, x in arrays.items():
        if x.ndim <= 2:
            wide = x.reshape(-1, 1) if x.ndim < 2 else x if x.shape[0] >= x.shape[1] else x.T
            pieces.setdefault(name.split(" {")[0], []).append(wide)
    return {
        name: np.concatenate(held)
        for name, held in pieces.items()
        if len({piece.shape[1] for piece in held}) == 1
    }


def _continued(vectors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``Time_a, Y_a, Time_b, Y_b`` as Time and Y, where parts have the same vectors in them."""
    times = [name for name in vectors if _is_time(name)]
    parts = [name.partition("_")[2] for name in times]
    held = {
        part: {n.partition("_")[0]: n for n in vectors if n.partition("_")[2] == part}
        for part in parts
    }
    first = held[parts[0]] if parts else {}
    if len(parts) < 2 or any(set(one) != set(first) for one in held.values()):
        return dict(vectors)
    whole = {
        base: [vectors[held[part][base]] for part in parts]
        for base in first
        if len({vectors[held[part][base]].shape[1] for part in parts}) == 1
    }
    return {base: np.concatenate(pieces) for base, pieces in whole.items()}


def _alike(vectors: Mapping[str, np.ndarray]) -> tuple[int, dict[str, np.ndarray]]:
    """Those of the length that the first time has, or else most have, as columns by name."""
    times = [name for name in vectors if _is_time(name) and rising(vectors[name][:, 0])]
    lengths = [len(vectors[name]) for name in times or vectors]
    length = lengths[0] if times else max(set(lengths), key=lambda n: (lengths.count(n), n))
    table: dict[str, np.ndarray] = {}
    for name, x in vectors.items():
        if len(x) == length:
            single = x.shape[1] == 1
            table |= {name if single else f"{name}({k + 1})": x[:, k] for k in range(x.shape[1])}
    return length, table


def _is_time(name: str) -> bool:
    plain = name.split("_")[0] if not meaning_of(name).kind else name
    return meaning_of(plain).kind == "time"


def _named(table: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """The table with its time called t; what no name tells is a place, unless a rate of one."""
    time = next((name for name in table if _is_time(name)), None)
    out = {("t" if name == time else name): x for name, x in table.items()}
    if any(meaning_of(name).kind == "place" and "(" not in name for name in out):
        return out, ()
    order = out.get("t", np.arange(len(next(iter(out.values()))), dtype=float))
    open_ = [name for name in out if "(" in name or not meaning_of(name).kind]
    unknown = [name for name in open_ if out[name].std() > 0]
    places = [
        name
        for name in unknown
        if not any(is_rate_of(out[name], out[other], order) for other in unknown if other != name)
    ]
    if not 1 <= len(places) <= 4:
        return out, ()
    called = {name: f"q{k + 1}" for k, name in enumerate(places)}
    rates = [name for name in unknown if name not in places]
    told = [f"{name} taken for coordinate {called[name]}" for name in places]
    if rates:
        told.append(f"{', '.join(rates)} for a rate, by its integral")
    return {called.get(name, name): x for name, x in out.items() if name not in rates}, (
        "; ".join(told),
    )


def _step(arrays: Mapping[str, np.ndarray]) -> float | None:
    """Seconds between samples, where the file has them."""
    for name, x in arrays.items():
        key = name.lower().replace("_", "")
        if x.size == 1 and x.item() > 0 and key in (*STEPS, *RATES):
            return x.item() if key in STEPS else 1 / x.item()
    return None


def _shapes(arrays: Mapping[str, np.ndarray]) -> str:
    return ", ".join(f"{name} {'x'.join(map(str, x.shape)) or x}" for name, x in arrays.items())
