"""What a kind of data set is: what it looks like, and the clips that it is read as."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from registry import Registry
from vidphys.data.clip_files import Dataset, Fact
from vidphys.data.formats import Recording
from vidphys.data.formats.bounded import reading, require_room
from vidphys.data.formats.columns import detect_columns
from vidphys.data.formats.rows import recording_of
from vidphys.data.formats.tapvid import is_points, points_of
from vidphys.data.labels import Labels
from vidphys.errors import InputError

MOST_CLIPS = 100_000
PLACES = ("positions", "pixels")  # arrays (t, n, 2)
TIMES = ("times", "timestamps", "timestamp", "time", "t")
RATES = ("fps", "rate", "frame_rate", "framerate")


@dataclass(frozen=True)
class SetFormat:
    """A kind of data set.

    Args:
        looks: whether what lies at a path, a file or a folder, is of this kind.
        read: gives its clips, each named as if the set were a folder; frames are read later. It
            raises ``ValueError`` with one line.
    """

    looks: Callable[[Path], bool]
    read: Callable[[Path], Dataset]


SETS: Registry[SetFormat] = Registry("data set", "vidphys.sets")


def labels_of(name: str, columns: Mapping[str, Any], load: Callable[[], Any]) -> Labels | None:
    """Labels in the columns of a clip, where there are places among them or could be.

    Args:
        name: of what they are in, to be told.
        columns: their names, and whatever is known of each.
        load: gives the columns, ``(t, ...)`` each.
    """

    def table() -> dict[str, np.ndarray]:
        with reading("columns of numbers"):
            held = {name: np.asarray(values) for name, values in load().items()}
        return {name: values for name, values in held.items() if values.ndim == 1}

    def places(told: Mapping[str, str]) -> Recording:
        return recording_of(table(), told, None)

    if is_points(columns) or any(place in columns for place in PLACES):
        return Labels(name, lambda told: arrays_recording(load(), told), table=table)
    return Labels(name, places, names=tuple(columns), table=table)


def arrays_recording(held: Mapping[str, Any], told: Mapping[str, str]) -> Recording:
    """Places in an array ``(t, n, 2)`` called positions or pixels, or TAP-Vid's points."""
    if told:
        raise InputError("`columns`: its places are an array, which has no names to choose by")
    if is_points(held):
        return points_of(held["points"], held["occluded"], None)
    name = next(name for name in PLACES if name in held)
    with reading(f"places in {name}"):
        places = np.asarray(held[name], float)
        times = next((np.asarray(held[each], float) for each in TIMES if each in held), None)
    if places.ndim == 2 and places.shape[-1] == 2:
        places = places[:, None]
    if places.ndim != 3:
        raise InputError(f"'{name}' {places.shape}; places of a clip are (t, n, 2)")
    require_room(places.shape, 8, name)
    clock = None if times is None or times.shape != places.shape[:1] else times[None]
    return Recording(places[None], clock, "pixels" if name == "pixels" else "world")


def in_plane(names: tuple[str, ...], columns: Mapping[str, str]) -> bool:
    """Whether columns of these names are places in a plane."""
    try:
        found = detect_columns(names, columns)
    except InputError:
        if columns:
            raise
        return False
    return all(len(body) == 2 for body in found.coordinates)


def facts_of(held: Mapping[str, Any]) -> dict[str, Fact]:
    """What of some values is a single number or word."""
    plain = {name: x.item() if isinstance(x, np.generic) else x for name, x in held.items()}
    return {
        str(name)[:300]: x[:300] if isinstance(x, str) else x
        for name, x in plain.items()
        if isinstance(x, str | int | float | bool)
    }


def times_of(held: Mapping[str, Any], count: int) -> np.ndarray:
    """Seconds of each frame, NaN where nothing tells them.

    Raises:
        InputError: times of another number of frames.
    """
    for name in TIMES:
        value = held.get(name)
        if value is not None and np.ndim(value) == 1:
            with reading(f"times in {name}"):
                times = np.asarray(value, float)
            if len(times) != count:
                raise InputError(f"{len(times)} {name} of {count} frames")
            return times
    for name in RATES:
        value = held.get(name)
        if value is not None and np.ndim(value) == 0 and float(value) > 0:
            return np.arange(count) / float(value)
    return np.full(count, np.nan)
