"""Tracks as SLEAP exports them (``.analysis.h5``): nodes of skeletons, in pixels.

DeepLabCut's HDF5 keeps the names of its columns in pickles, which can run any code; its CSV is
read.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.foreign import read_apart
from vidphys.data.formats.poses import of_parts
from vidphys.errors import InputError

HDF5 = (".h5", ".hdf5", ".hdf")
KEPT = 1  # files whose arrays are kept, from when their kind is asked until they are read


def is_sleap(path: Path) -> bool:
    """Whether an HDF5 file has SLEAP's arrays; not told where h5py is missing."""
    if importlib.util.find_spec("h5py") is None:
        return False
    try:
        return "tracks" in _arrays(path, path.stat().st_mtime_ns)
    except InputError:
        return False


@lru_cache(KEPT)
def _arrays(path: Path, _changed: int) -> dict[str, np.ndarray]:
    """Its tracks and their names; empty where it is of another kind."""
    return read_apart(path, "sleap", ["h5py"])


def read_sleap(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The nodes of all skeletons, each a body; NaN where one was not seen.

    Raises:
        InputError: arrays of another shape, or a node that it does not have.
    """
    held = _arrays(path, path.stat().st_mtime_ns)
    tracks, nodes = held["tracks"], held["node_names"].tolist()
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.shape[2] != len(nodes):
        raise InputError(
            f"'tracks' {tracks.shape} of {len(nodes)} nodes; SLEAP has (tracks, 2, nodes, frames)"
        )
    animals = held["track_names"].tolist() if len(tracks) > 1 else [""]
    names = [f"{animal} {node}".strip() for animal in animals for node in nodes]
    places = tracks.transpose(3, 0, 2, 1).reshape(tracks.shape[3], -1, 2).astype(float)
    return of_parts(places, names, columns, np.arange(len(places)), interval, "SLEAP's nodes")
