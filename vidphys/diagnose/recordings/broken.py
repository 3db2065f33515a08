"""Frames that a recording shows twice, pauses, and frames that are missing without a trace.

A body that moves is nowhere twice in a row, with the same speed before and after, unless a frame
was shown again; the picture must then be the same too, up to what compression changes. It does not
go twice as far in one frame as in those before and after, unless one between them is missing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from binders.base import Pictures
from vidphys.statistics import noise_of

STANDS = 0.12  # of the steps before and after, that a body may seem to move in a frame shown twice
ONWARD = 0.5  # least cosine between those steps; it does not turn there
SHOWN = 6.0  # times the noise of a place, from which a step shows
SAME = 0.4  # of the picture's change before and after, that compression may leave
PAUSE = 5  # frames in a row, from which the recording may have been paused
MISSING = 3  # frames that may be missing at one place
AROUND = 4  # frames before and after it, in which motion is smooth
FEWEST = 3  # of them at the ends of a recording
QUARTIC = 4  # degree of the polynomial through them
GAP = 1.5  # intervals between two frames, from which the stamps show that one is missing
GOES_ON = 4.0  # times the noise, up to which motion is smooth
BREAKS = 4.0  # times what is left then, from which it is not
WORSE = 3.0  # the same, for any other number of missing frames


@dataclass(frozen=True)
class Mended:
    """What was seen, without frames that were shown again, at the times at which it was.

    Args:
        positions: ``(t, n, d)``; NaN in frames that were shown again.
        times: seconds, ``(t,)``; moved where a pause or a missing frame moved them.
        doubled: frames that show the picture before again.
        paused: the same, where so many are in a row that the recording was paused.
        missing: frames before which others are missing, and how many.
    """

    positions: Float[np.ndarray, "t n d"]
    times: Float[np.ndarray, " t"]
    doubled: tuple[int, ...] = ()
    paused: tuple[int, ...] = ()
    missing: tuple[tuple[int, int], ...] = ()


def mend(
    positions: Float[np.ndarray, "t n d"],
    times: Float[np.ndarray, " t"],
    frames: Pictures,
) -> Mended:
    """Leave out frames that were shown again, and make room for those that are missing.

    A single frame keeps its time stamp, which is then a gap. After a pause from which bodies go on
    as slowly as they went before it, the clock goes on where it stopped.
    """
    steps, noise, times = np.diff(positions, axis=0), noise_of(positions), times.copy()
    usual = float(np.median(np.diff(times)))
    doubled: list[int] = []
    paused: list[int] = []
    first = 2
    while first < len(positions) - 1:
        stop = _stands(steps, first, noise, frames)
        again = range(first, stop)
        if len(again) >= PAUSE:
            paused += again
            if _length(steps[stop - 1]) < len(again) / 2 * _length(steps[first - 2]):
                before = times[first - 1]  # the clock stood from here on
                times[stop:] -= times[stop] - before - usual
                times[first:stop] = before + usual * np.linspace(0, 1, len(again) + 2)[1:-1]
        else:
            doubled += again
        first = max(stop, first) + 1
    seen = positions.copy()
    seen[doubled + paused] = np.nan
    missing = _missing(seen, times, noise)
    for frame, count in missing:
        times[frame:] += count * usual
    return Mended(seen, times, tuple(doubled), tuple(paused), tuple(missing))


def _length(step: np.ndarray) -> float:
    return float(np.sqrt(np.nansum(step**2)))


def _stands(steps: np.ndarray, first: int, noise: float, frames: Pictures) -> int:
    """The frame after those from ``first`` on that show the one before it again, or ``first``."""
    for stop in range(first + 1, len(steps) + 1):
        part = steps[first - 2 : stop]  # before, those in question, after
        before, *still, after = part[:, np.isfinite(part).all((0, 2))]
        fast, moved = _length(before), max(map(_length, still))
        if fast < SHOWN * noise or moved > STANDS * fast:
            return first
        if min(_length(after), fast) < max(SHOWN * noise, moved / STANDS):
            continue  # perhaps it stands for longer
        onward = float((before * after).sum()) > ONWARD * fast * _length(after)
        return stop if onward and _same(frames, first, stop) else first
    return first


def _same(frames: Pictures, first: int, stop: int) -> bool:
    """Whether the pictures ``first`` to ``stop`` change far less than those around."""
    change = [_change(frames[k - 1], frames[k]) for k in range(first - 1, stop + 1)]
    return max(change[1:-1]) < SAME * min(change[0], change[-1])


def _change(before: np.ndarray, after: np.ndarray) -> float:
    """Root mean square, brightness levels."""
    apart = after.astype(np.float32) - before
    return float(np.sqrt(np.mean(apart**2)))


def _missing(positions: np.ndarray, times: np.ndarray, noise: float) -> list[tuple[int, int]]:
    """Frames before which others are missing though no stamp shows it, and how many.

    A quartic through the frames around goes on only if time is given to those that are missing.
    """
    times, usual, found = times.copy(), float(np.median(np.diff(times))), []
    for frame in range(FEWEST, len(positions) - FEWEST + 1):
        if times[frame] - times[frame - 1] > GAP * usual:
            continue
        near = slice(max(frame - AROUND, 0), frame + AROUND)
        path = positions[near][:, np.isfinite(positions[near]).all((0, 2))]
        if not path.size:
            continue
        since = (times[near] - times[frame]) / usual
        late = np.arange(len(since)) >= frame - near.start
        left = np.array(
            [_left(since + n * late, path.reshape(len(path), -1)) for n in range(MISSING + 1)]
        )
        count = int(left.argmin())
        least = max(float(left[count]), noise)
        others = np.delete(left, count).min()
        smooth = left[count] < GOES_ON * noise and left[0] > BREAKS * least
        if count and smooth and others > WORSE * least:
            found.append((frame, count))
            times[frame:] += count * usual
    return found


def _left(times: np.ndarray, path: np.ndarray) -> float:
    """Root mean square that a quartic leaves of ``(t, k)``, of one coordinate."""
    powers = np.vander(times, QUARTIC + 1)
    rest = path - powers @ np.linalg.lstsq(powers, path, rcond=None)[0]
    return float(np.sqrt((rest**2).sum() / ((len(path) - QUARTIC - 1) * path.shape[1])))
