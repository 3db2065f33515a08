"""Point tracks as TAP-Vid has them: ``points (n, t, 2)`` in shares of the picture, ``occluded``.

Its own files are pickles, which can run any code and are not opened; an NPZ or JSON of the same two
arrays is read.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import reading
from vidphys.data.formats.tables import arrays_of, headers_of, numbers_of
from vidphys.errors import InputError

NAMES = ("points", "occluded")


def is_points(held: Any) -> bool:
    """Whether a mapping has these arrays."""
    return isinstance(held, Mapping) and all(name in held for name in NAMES)


def is_tapvid(path: Path) -> bool:
    """Whether an NPZ has these arrays."""
    try:
        with reading("an npz file"), ZipFile(path) as archive:
            members = {name.removesuffix(".npy") for name in archive.namelist()}
    except InputError:
        return False
    return set(NAMES) <= members


def read_tapvid(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The point tracks of an NPZ."""
    with reading("an npz file of numbers"):
        held = arrays_of(path, NAMES)
    return points_of(held["points"], held["occluded"], interval)


def points_table(path: Path) -> dict[str, np.ndarray]:
    """What else an NPZ of point tracks has for each frame."""
    with reading("an npz file of numbers"):
        return numbers_of(path, headers_of(path)["points"][0][1:2])


def points_of(points: Any, occluded: Any, interval: float | None) -> Recording:
    """Tracks, each a body.

    Args:
        points: ``(n, t, 2)``, shares of the picture's width and height from its top left corner.
        occluded: ``(n, t)``, true where a point was not seen.
        interval: seconds between frames.

    Raises:
        InputError: arrays of another shape, or points far from the picture.
    """
    with reading("TAP-Vid's points"):
        places, hidden = np.asarray(points, float), np.asarray(occluded, bool)
    if places.ndim != 3 or places.shape[-1] != 2 or hidden.shape != places.shape[:2]:
        raise InputError(
            f"'points' {places.shape} and 'occluded' {hidden.shape}; TAP-Vid has (n, t, 2), (n, t)"
        )
    if not places.size:
        raise InputError(f"'points' {places.shape} holds nothing")
    seen = places[~hidden]
    if len(seen) and not np.abs(seen).max() < 10:
        raise InputError(
            "'points' reach far out of the picture; TAP-Vid counts in shares of its width and "
            "height, so divide pixels by these"
        )
    places = np.where(hidden[..., None], np.nan, places).transpose(1, 0, 2)
    frames = np.arange(len(places))
    times = None if interval is None else (frames * interval)[None]
    note = f"{places.shape[1]} point tracks of TAP-Vid, shares of the picture"
    return Recording(places[None], times, "picture", notes=(note,), frames=frames)
