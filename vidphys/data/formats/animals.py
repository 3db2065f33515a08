"""HDF5 of programs that track animals (SLEAP, DeepLabCut): whose a file is, and its arrays."""

from __future__ import annotations

import importlib.util
from functools import lru_cache
from pathlib import Path

import numpy as np

from vidphys.data.formats.foreign import read_apart
from vidphys.errors import InputError

HDF5 = (".h5", ".hdf5", ".hdf")
KEPT = 1  # files whose arrays are kept, from when their kind is asked until they are read


def holds(path: Path, name: str) -> bool:
    """Whether an HDF5 file has such an array of one of them; not told where h5py is missing."""
    if path.suffix.lower() not in HDF5 or importlib.util.find_spec("h5py") is None:
        return False
    try:
        return name in arrays_of_tracks(path)
    except InputError:
        return False


def arrays_of_tracks(path: Path) -> dict[str, np.ndarray]:
    """Its tracks and their names; empty where it is of another kind."""
    return _arrays(path, path.stat().st_mtime_ns)


@lru_cache(KEPT)
def _arrays(path: Path, _changed: int) -> dict[str, np.ndarray]:
    return read_apart(path, "tracks", ["h5py"])
