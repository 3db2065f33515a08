"""Tracks in HDF5, as programs that track animals keep them."""

from __future__ import annotations

import io
import pickle
from typing import Any

import h5py
import numpy as np
from confined import RefusedError, require_room
from hdf5 import in_here, is_own, plain

SLEAP = "tracks", "node_names", "track_names"
BLOCK = "values_block_0"  # all numbers of a table whose columns are of one type


def sleap(file: h5py.File, most_bytes: int) -> dict[str, np.ndarray]:
    """SLEAP's tracks and their names; nothing where there are none."""
    own = {name: file[name] for name in SLEAP if is_own(file, name)}
    held = {name: in_here(x) for name, x in own.items() if isinstance(x, h5py.Dataset)}
    if len(held) < len(SLEAP):
        return {}
    for name, x in held.items():
        require_room(x.shape, most_bytes, name)
    words = {name: np.array([plain(word) for word in held[name][()]], str) for name in SLEAP[1:]}
    return {"tracks": held["tracks"][()], **words}


def deeplabcut(file: h5py.File, most_bytes: int) -> dict[str, np.ndarray]:
    """DeepLabCut's table, which pandas has written; nothing where there is none.

    Its ``heads (levels, columns)`` stand under ``levels``, its ``values (frames, columns)`` beside
    ``index (frames,)``, which is empty where it is no number.
    """
    for name in file:
        group = file[name] if is_own(file, name) else None
        if not isinstance(group, h5py.Group) or not is_own(group, "table"):
            continue
        table, levels = group["table"], _levels(group)
        if isinstance(table, h5py.Dataset) and BLOCK in (table.dtype.names or ()) and levels:
            return _table(in_here(table), group, levels, most_bytes)
    return {}


def _table(
    table: h5py.Dataset, group: h5py.Group, levels: list[str], most_bytes: int
) -> dict[str, np.ndarray]:
    ((_, columns),) = _unpickled(group.attrs["non_index_axes"])
    width = table.dtype[BLOCK].shape[0]
    if {len(levels)} != {len(names) for names in columns} or len(columns) != width:
        raise RefusedError(f"{len(columns)} names of {width} columns")
    require_room((len(table), width + 1), most_bytes, "a table")
    rows = table[()]
    numbered = "index" in rows.dtype.names and rows.dtype["index"].kind in "iuf"
    return {
        "levels": np.array(levels, str),
        "heads": np.array([[str(plain(name)) for name in names] for names in columns], str).T,
        "values": rows[BLOCK].astype(float),
        "index": rows["index"] if numbered else np.zeros(0),
    }


def _levels(group: h5py.Group) -> list[str]:
    """What the levels of its columns' names are called; empty where they have one."""
    if "info" not in group.attrs or "non_index_axes" not in group.attrs:
        return []
    about = _unpickled(group.attrs["info"]).get(1, {})
    return [str(plain(name)) for name in about.get("names", [])]


class _Words(pickle.Unpickler):
    """Lists, words and numbers; a pickle of anything else could run any code."""

    def find_class(self, module: str, name: str) -> Any:
        raise RefusedError(f"its names hold {module}.{name}, which no names need")


def _unpickled(held: bytes) -> Any:
    return _Words(io.BytesIO(held)).load()
