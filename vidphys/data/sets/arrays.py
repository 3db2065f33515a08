"""Clips as arrays: an NPZ, or an HDF5 file with a group for each clip.

A clip is ``frames`` (or ``video``, ``images``), bytes ``(t, H, W, 3)``; beside it ``times (t,)`` or
``fps``, and where its bodies are: ``positions`` or ``pixels`` ``(t, n, 2)``, TAP-Vid's ``points``
and ``occluded``, or columns ``x1``, ``y1``, ... ``(t,)``. Whatever else is a single number or word
is a fact of the clip; ``split`` puts it into one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.bounded import MOST_MEMBERS, reading, require_room
from vidphys.data.formats.tables import arrays_of, headers_of
from vidphys.data.sets.base import MOST_CLIPS, SetFormat, facts_of, labels_of, times_of
from vidphys.data.sets.sources import arrays, frames_in
from vidphys.errors import InputError

FRAMES = ("frames", "video", "images")
NPZ, HDF5 = ".npz", (".h5", ".hdf5", ".hdf")


def looks(path: Path) -> bool:
    """Whether a file is of this kind."""
    if not path.is_file():
        return False
    if path.suffix.lower() in HDF5:
        return True
    if path.suffix.lower() != NPZ:
        return False
    try:
        with reading("an npz file"):
            return any(name in headers_of(path) for name in FRAMES)
    except InputError:
        return False


def read(path: Path) -> Dataset:
    """The clips of a file."""
    if path.suffix.lower() == NPZ:
        with reading("an npz file of numbers"):
            return Dataset((_npz(path),), stored=(path,))
    with reading("an HDF5 file"):
        return Dataset(tuple(_hdf5(path)), stored=(path,))


def _clip(
    path: Path, held: Mapping[str, Any], frame: Callable[[int], np.ndarray], count: int, by: str
) -> ClipFile:
    """One clip.

    Args:
        path: its name in the set.
        held: everything but the frames: arrays, numbers and words.
        frame: by its number.
        count: of the frames.
        by: the package that reads them.
    """
    columns = {name: x for name, x in held.items() if np.ndim(x) and len(x) == count}
    columns |= {name: held[name] for name in ("points", "occluded") if name in held}
    facts = facts_of({name: x for name, x in held.items() if np.ndim(x) == 0})
    split = str(facts.pop("split", ""))
    return ClipFile(
        path,
        labels_of("arrays beside the frames", columns, lambda: columns) if columns else None,
        facts=facts,
        split=split,
        source=arrays(frame, times_of(held, count), by),
    )


def _npz(path: Path) -> ClipFile:
    headers = headers_of(path)
    name = next(each for each in FRAMES if each in headers)
    shape, dtype = headers[name]
    frames_in(shape, dtype, f"'{name}'")
    beside = {n: (s, d) for n, (s, d) in headers.items() if n != name and d.kind in "fiubU"}
    words = [n for n, (s, d) in beside.items() if d.kind == "U" and not s and d.itemsize < 4000]
    held: dict[str, Any] = arrays_of(path, [n for n, (_, d) in beside.items() if d.kind != "U"])
    with np.load(path, allow_pickle=False) as file:
        held |= {each: file[each] for each in words}
    whole: list[np.ndarray] = []

    def frame(number: int) -> np.ndarray:
        if not whole:
            whole.append(arrays_of(path, [name])[name])
        return whole[0][number]

    held = {each: x.item() if x.ndim == 0 else x for each, x in held.items()}
    return _clip(path / "0", held, frame, shape[0], "numpy")


def _hdf5(path: Path) -> list[ClipFile]:
    try:
        import h5py
    except ImportError as error:
        raise InputError("reading HDF5 needs h5py: pip install 'vidphys[sets]'") from error
    with h5py.File(path, "r") as file:
        groups = [("0", file)] if _frames(file) else []
        groups += [(name, group) for name, group in _own(file).items() if _is_clip(group)]
        if len(groups) > MOST_CLIPS:
            raise InputError(f"{len(groups)} clips, more than {MOST_CLIPS}")
        return [_of_group(path, name, group) for name, group in groups]


def _own(group: Any) -> dict[str, Any]:
    """What a group holds itself, without what its links lead to, in other files or elsewhere."""
    import h5py

    if len(group) > MOST_MEMBERS:
        raise InputError(f"{len(group)} members of a group, more than {MOST_MEMBERS}")
    named = (n for n in group if isinstance(group.get(n, getlink=True), h5py.HardLink))
    return {name: group[name] for name in named}


def _frames(group: Any) -> Any:
    """The frames of a group, if it has some."""
    held = _own(group)
    found = next((held[name] for name in FRAMES if name in held), None)
    if found is None or not hasattr(found, "shape"):
        return None
    if found.external or found.is_virtual:
        raise InputError(f"{found.name} lies in another file; copy it into this one")
    return found


def _is_clip(group: Any) -> bool:
    return hasattr(group, "keys") and _frames(group) is not None


def _of_group(path: Path, name: str, group: Any) -> ClipFile:
    frames = _frames(group)
    frames_in(frames.shape, frames.dtype, frames.name)
    held: dict[str, Any] = {}
    for key, value in _own(group).items():
        if key in FRAMES or not hasattr(value, "shape") or value.dtype.kind not in "fiubO":
            continue
        if value.external or value.is_virtual:
            raise InputError(f"{value.name} lies in another file; copy it into this one")
        if value.dtype.kind == "O" and value.shape:
            continue
        require_room(value.shape, value.dtype.itemsize, value.name)
        held[key] = value[()] if value.shape else _plain(value[()])
    held |= {key: _plain(x) for key, x in group.attrs.items() if np.ndim(x) == 0}
    one = partial(_one, path, frames.name)
    return _clip(path / name, held, one, frames.shape[0], "h5py")


def _plain(value: Any) -> Any:
    return value.decode(errors="replace") if isinstance(value, bytes) else value


class _Open:
    """The HDF5 file that frames were read from last."""

    path: Path | None = None
    file: Any = None


def _one(path: Path, name: str, number: int) -> np.ndarray:
    import h5py

    if _Open.path != path or not _Open.file:
        _Open.path, _Open.file = path, h5py.File(path, "r")
    with reading("frames of an HDF5 file"):
        return _Open.file[name][number]


ARRAYS = SetFormat(looks, read)
