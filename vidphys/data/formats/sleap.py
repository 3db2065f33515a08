"""Tracks as SLEAP exports them (``.analysis.h5``): nodes of skeletons, in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vidphys.data.formats.animals import arrays_of_tracks, holds
from vidphys.data.formats.base import Recording
from vidphys.data.formats.poses import of_parts
from vidphys.errors import InputError


def is_sleap(path: Path) -> bool:
    """Whether an HDF5 file has SLEAP's arrays."""
    return holds(path, "tracks")


def read_sleap(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The nodes of all skeletons, each a body; NaN where one was not seen.

    Raises:
        InputError: arrays of another shape, or a node that it does not have.
    """
    held = arrays_of_tracks(path)
    tracks, nodes = held["tracks"], held["node_names"].tolist()
    if tracks.ndim != 4 or tracks.shape[1] != 2 or tracks.shape[2] != len(nodes):
        raise InputError(
            f"'tracks' {tracks.shape} of {len(nodes)} nodes; SLEAP has (tracks, 2, nodes, frames)"
        )
    animals = held["track_names"].tolist() if len(tracks) > 1 else [""]
    names = [f"{animal} {node}".strip() for animal in animals for node in nodes]
    places = tracks.transpose(3, 0, 2, 1).reshape(tracks.shape[3], -1, 2).astype(float)
    return of_parts(places, names, columns, np.arange(len(places)), interval, "SLEAP's nodes")
