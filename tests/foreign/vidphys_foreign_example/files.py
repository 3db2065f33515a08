"""Two formats: tracks as lines of JSON in millimetres, and clips as arrays of frames."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vidphys.data.formats import ClipFormat, Recording, TrackFormat
from vidphys.data.formats.base import Frames


def read_trk(path: Path, columns: Mapping[str, str], interval: float | None) -> Recording:
    """A line with the rate and the unit, then one for each frame: a place or null for each body."""
    try:
        head, *rows = [json.loads(line) for line in path.read_text().splitlines() if line.strip()]
        scale = {"m": 1.0, "mm": 1e-3, "px": 1.0}[head["unit"]]
        places = [[[np.nan] * 2 if at is None else at for at in row["at"]] for row in rows]
        positions = np.array(places, float)[None] * scale
        rate = float(head["rate"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"not a .marks file ({error!r})") from error
    times = np.arange(len(rows))[None] / rate
    unit = "pixels" if head["unit"] == "px" else "world"
    return Recording(positions, times, unit, notes=(f"trk in {head['unit']}",))


def read_stack(path: Path) -> tuple[float, int, Frames]:
    """An NPZ of ``frames (t, H, W, 3)``, bytes, and ``rate``."""
    try:
        with np.load(path) as held:
            frames, rate = held["frames"], float(held["rate"])
    except (OSError, EOFError, KeyError, ValueError) as error:
        raise ValueError(f"{path}: not a stack of frames ({error})") from error
    return rate, len(frames), ((frame, k / rate) for k, frame in enumerate(frames))


TRK = TrackFormat((".marks",), read_trk)
STACK = ClipFormat((".stack",), read_stack)
