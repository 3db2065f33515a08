"""Clips as arrays: an NPZ, or an HDF5 file with a group for each clip.

A clip is ``frames`` (or ``video``, ``images``), bytes ``(t, H, W, 3)``; beside it ``times (t,)`` or
``fps``, and where its bodies are: ``positions`` or ``pixels`` ``(t, n, 2)``, TAP-Vid's ``points``
and ``occluded``, or columns ``x1``, ``y1``, ... ``(t,)``. Whatever else is a single number or word
is a fact of the clip; ``split`` puts it into one.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats.animals import HDF5
from vidphys.data.formats.bounded import reading
from vidphys.data.formats.deeplabcut import is_deeplabcut
from vidphys.data.formats.sleap import is_sleap
from vidphys.data.formats.tables import arrays_of, headers_of
from vidphys.data.sets.apart import Group, frames_of, groups_of
from vidphys.data.sets.base import SetFormat, facts_of, labels_of, times_of
from vidphys.data.sets.sources import arrays, frames_in
from vidphys.errors import InputError

FRAMES = ("frames", "video", "images")
NPZ = ".npz"


def looks(path: Path) -> bool:
    """Whether a file is of this kind."""
    if not path.is_file():
        return False
    if path.suffix.lower() in HDF5:
        return not (is_sleap(path) or is_deeplabcut(path))
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
    if importlib.util.find_spec("h5py") is None:
        raise InputError("reading HDF5 needs h5py: pip install 'vidphys[sets]'")
    clips = tuple(_of_group(path, one) for one in groups_of(path, FRAMES))
    if not clips:
        raise InputError(
            f"no group in it has an array called {', '.join(FRAMES)}, nor is it SLEAP's or "
            "DeepLabCut's; if it holds tracks, give them as CSV"
        )
    return Dataset(clips, stored=(path,))


def _clip(
    path: Path,
    held: Mapping[str, Any],
    frames: Callable[[], Iterable[np.ndarray]],
    count: int,
    by: str,
) -> ClipFile:
    """One clip.

    Args:
        path: its name in the set.
        held: everything but the frames: arrays, numbers and words.
        frames: one after the other.
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
        source=arrays(frames, times_of(held, count), by),
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
    whole = cache(lambda: arrays_of(path, [name])[name])
    held = {each: x.item() if x.ndim == 0 else x for each, x in held.items()}
    return _clip(path / "0", held, whole, shape[0], "numpy")


def _of_group(path: Path, group: Group) -> ClipFile:
    frames_in(group.shape, group.dtype, group.frames)
    load = partial(frames_of, path, group.frames, group.shape)
    return _clip(path / group.name, {**group.arrays, **group.facts}, load, group.shape[0], "h5py")


ARRAYS = SetFormat(looks, read)
