"""Parts of bodies, as programs that track animals tell them: each is a body."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vidphys.data.formats.base import Recording, Unit
from vidphys.data.formats.captured import wanted
from vidphys.errors import InputError


def of_parts(
    places: np.ndarray,
    names: Sequence[str],
    columns: Mapping[str, str],
    frames: np.ndarray,
    interval: float | None,
    whose: str,
) -> Recording:
    """A recording of those parts that are wanted and seen in some frame.

    Args:
        places: ``(t, n, d)``, pixels in the plane; NaN where one was not seen.
        names: of the parts.
        columns: which are wanted; see :func:`.captured.wanted`.
        frames: numbers of the frames, ``(t,)``.
        interval: seconds between frames, if it is known.
        whose: parts they are.

    Raises:
        InputError: none of them is seen, or one is wanted that is not there.
    """
    taken = [n for n in wanted(names, columns) if np.isfinite(places[:, n]).all(-1).any()]
    if not taken:
        raise InputError(f"none of {whose} is seen in any frame")
    times = None if interval is None else (frames * interval)[None]
    unit: Unit = "pixels" if places.shape[-1] == 2 else "world"
    note = f"{whose}, in {unit}: {', '.join(names[n] for n in taken)}"
    return Recording(places[None][:, :, taken], times, unit, notes=(note,), frames=frames)
