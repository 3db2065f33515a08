"""Motion capture as C3D: markers in space, with the system's rate and unit, in binary form."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from vidphys.data.formats.base import Recording
from vidphys.data.formats.captured import of_markers, wanted
from vidphys.data.formats.foreign import read_apart
from vidphys.errors import InputError


def read_c3d(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """The markers of a file, each a body; NaN where one was not seen.

    Its own rate tells the times, unless an interval is given. What plates and muscles measured
    beside the markers is not read.

    Raises:
        InputError: no marker is seen, or one is asked for that it does not have.
    """
    if importlib.util.find_spec("c3d") is None:
        raise InputError("reading C3D needs the package c3d: pip install 'vidphys[capture]'")
    held = read_apart(path, "c3d", ["c3d"])
    names = held["names"].tolist()
    taken = wanted(names, columns)
    rate = float(held["rate"]) if interval is None else 1 / interval
    unit = str(held["unit"])
    found = of_markers(held["places"][:, taken], [names[n] for n in taken], rate, unit)
    told, there = int(held["frames"]), len(held["places"])
    if told == there:
        return found
    return replace(
        found, notes=(*found.notes, f"it tells of {told} frames, and ends after {there}")
    )
