"""``vidphys diagnose CLIP --look``: a picture of what may be a body, to choose from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vidphys.errors import InputError

if TYPE_CHECKING:
    from binders.base import Binder
    from vidphys.data.video import ClipSelection

MOST = 8  # that are shown
PICTURE = "look.png"


def look(path: Path, selection: ClipSelection, binder: Binder, folder: Path) -> list[str]:
    """Draw what moves in a clip, numbered as ``--choose`` counts it; returns what to say.

    Raises:
        InputError: a clip that cannot be read, in which nothing moves, or a binder of another kind.
    """
    from binders.motion import MotionBinder
    from vidphys.diagnose.recordings.clips import clip_of, whole_part
    from vidphys.runs.atomic import write_with
    from viz.look import look_sheet

    if not isinstance(binder, MotionBinder):
        raise InputError("--look: only the binder motion tells what it chooses from")
    video = clip_of(path, selection)
    first, stop, _ = whole_part(video, binder)
    frames, numbers = video.frames[first:stop], video.indices[first:stop]
    times = (video.times - video.times[0])[first:stop]
    try:
        places, sizes = binder.candidates(frames, video.times[first:stop])
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error
    places, sizes = places[:, :MOST], sizes[:MOST]
    figure = look_sheet(frames, numbers, times, places, sizes)
    target = folder / PICTURE
    write_with(target, lambda partial: figure.savefig(partial, format="png"))
    lines = [_thing(places[:, n], sizes[n], n + 1, numbers) for n in range(len(sizes))]
    return [*lines, f"picture: {target}; follow some of them by --choose 1 or --choose 1 2"]


def _thing(places: np.ndarray, size: float, number: int, numbers: np.ndarray) -> str:
    """Where it is first seen, in the form that ``--at`` takes."""
    seen = np.flatnonzero(np.isfinite(places[:, 0]))
    x, y = places[seen[len(seen) // 2]]
    return (
        f"{number}: {2 * size:.0f} px wide, seen in {len(seen)} of {len(numbers)} frames, "
        f"at {x:.0f},{y:.0f},{numbers[seen[len(seen) // 2]]}"
    )
