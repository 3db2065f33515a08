"""Motion whose frames came at uneven times, read off at even ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

CUBIC = 3
APART = 1.6  # intervals between neighbouring frames, beyond which one is missing


def evened(motion: Motion) -> Motion:
    """The same motion at the median interval: a cubic spline through the frames that show a body.

    Between frames that lie further apart than unevenness alone leaves them, nothing is seen.

    Args:
        motion: frames at any times.

    Example:
        >>> t = np.cumsum([0, 1, 1, 1.2, 0.8, 1, 1, 1.5, 0.5, 1, 1])[None] * 0.1
        >>> even = evened(Motion(np.sin(t)[..., None, None], t, np.ones((1, 1))))
        >>> off = even.positions[0, :, 0, 0] - np.sin(even.times)
        >>> even.times.shape, bool(abs(off).max() < 1e-3)
        ((1, 11), True)
    """
    step = motion.interval
    since = motion.times - motion.times[:, :1]
    steps = int(float(since[:, -1].max()) / step + 1e-6)
    grid = step * np.arange(steps + 1)
    positions = np.full((motion.clips, len(grid), motion.bodies, motion.space), np.nan)
    for clip in range(motion.clips):
        for body in range(motion.bodies):
            seen = motion.seen[clip, :, body]
            path = motion.positions[clip, seen, body]
            positions[clip, :, body] = _read(since[clip, seen], path, grid, step)
    times = motion.times[:, :1] + grid
    return replace(motion, positions=positions, times=times)


def _read(times: np.ndarray, path: np.ndarray, grid: np.ndarray, step: float) -> np.ndarray:
    """Places ``(grid, d)`` on the spline through ``(t, d)``; NaN away from what was seen."""
    from scipy.interpolate import (
        make_interp_spline,  # a tenth of a second to load, and seldom asked
    )

    out = np.full((len(grid), path.shape[1]), np.nan)
    if len(times) <= CUBIC:
        return out
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    held = times[after] - times[after - 1] <= APART * step
    near = np.abs(grid - times[after]) <= 1e-6 * step
    near |= np.abs(grid - times[after - 1]) <= 1e-6 * step
    inside = (grid >= times[0]) & (grid <= times[-1])
    used = held & inside | near
    out[used] = make_interp_spline(times, path, CUBIC)(grid[used])
    return out
