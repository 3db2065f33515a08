"""Whether frames come at even times, and tracks read off at even times where they do not."""

from __future__ import annotations

import numpy as np
import torch
from scipy.interpolate import make_interp_spline

from binders.tracks import Tracks

JITTER = 0.02  # share of an interval by which the frames of an even clip may be early or late
CUBIC = 3
APART = 1.6  # intervals between neighbouring frames, from which one is missing between them
ROUNDED = 1e-3  # seconds that some containers round their stamps to


def jitter(times: np.ndarray) -> float:
    """By how much frames are early or late at most, in intervals; rounding to milliseconds is none.

    Args:
        times: seconds ``(t,)``, rising.
    """
    if len(times) < 3:
        return 0.0
    steps = np.arange(len(times))
    slope, start = np.polyfit(steps, times, 1)
    late = np.abs(times - start - slope * steps).max()
    whole = np.abs(times / ROUNDED - np.rint(times / ROUNDED)).max() < 1e-3
    return 0.0 if whole and late <= 0.75 * ROUNDED else float(late / slope)


def evenly(track: Tracks, end: int) -> Tracks:
    """The frames of a track before one of them, at even times: themselves where they come so.

    Else they are read off a cubic spline at their median interval, up to the last of them; where
    frames are missing nothing is sure.

    Args:
        track: of one clip or several with the same times.
        end: number of the frame to stop before.
    """
    track = Tracks(track.positions[:, :end], track.confidence[:, :end], track.times[:end])
    times = track.times.double().numpy()
    if jitter(times) <= JITTER or len(times) <= CUBIC:
        return track
    step = float(np.median(np.diff(times)))
    count = int((times[-1] - times[0]) / step + 1e-6) + 1
    grid = times[-1] - step * np.arange(count)[::-1]
    after = np.clip(np.searchsorted(times, grid), 1, len(times) - 1)
    before = after - 1
    share = ((grid - times[before]) / (times[after] - times[before])).clip(0, 1)
    near = np.minimum(share, 1 - share) * (times[after] - times[before]) <= 1e-6 * step
    held = (times[after] - times[before] <= APART * step) | near
    path = make_interp_spline(times, track.positions.double().numpy(), CUBIC, axis=1)(grid)
    sure = track.confidence.double().numpy()
    share = share[:, None]
    sure = (1 - share) * sure[:, before] + share * sure[:, after]
    return Tracks(
        torch.from_numpy(path).to(track.positions),
        torch.from_numpy(sure * held[:, None]).to(track.confidence),
        torch.from_numpy(grid),
    )
