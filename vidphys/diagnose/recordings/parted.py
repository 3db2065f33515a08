"""Bodies that touch in a picture: where a tracker took two for one, and exchanged them after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

FRAMES = 8  # through which a straight line tells where a body is next
SURELY = 6.0  # times the usual distance from such a line
NEAR = 1.6  # times the least distance, within which two bodies may touch
MOST = 14  # frames in which they are one at most
EXCHANGED = 0.3  # of the gap between paths, to which the exchange of two names must bring it


def parted(motion: Motion) -> Motion:
    """The motion without frames in which two bodies that touch were taken for one.

    What follows such frames changes its name where paths go on only then.

    Args:
        motion: of what was followed in a clip.
    """
    positions = motion.positions.copy()
    for path, times in zip(positions, motion.times, strict=True):
        for i in range(motion.bodies):
            for j in range(i + 1, motion.bodies):
                _part(path, times, i, j)
    return replace(motion, positions=positions)


def _part(path: np.ndarray, times: np.ndarray, i: int, j: int) -> None:
    """Change the places ``(t, n, d)`` of two bodies of a clip."""
    usual = np.array([_usual(path[:, k], times) for k in (i, j)])
    if not np.isfinite(usual).all():
        return
    for meet in _nearest(path[:, [i, j]]):
        first, last = meet - MOST, meet + MOST
        if first < FRAMES or last + FRAMES >= len(path):
            first, last = max(first, FRAMES), min(last, len(path) - FRAMES - 1)
        pair = path[:, [i, j]]
        leaves = _leaves(pair, times, first, last, usual)
        back = _leaves(pair[::-1], -times[::-1], len(path) - 1 - last, len(path) - 1 - first, usual)
        if leaves is None or back is None:
            continue
        begin, end = leaves, len(path) - 1 - back
        if begin <= end <= begin + MOST:
            path[begin : end + 1, [i, j]] = np.nan
        if begin <= end + 1 and _exchanged(pair, times, min(begin, end + 1), max(begin, end + 1)):
            path[end + 1 :, [i, j]] = path[end + 1 :, [j, i]]


def _usual(path: np.ndarray, times: np.ndarray) -> float:
    """Distance of a body from where a straight line through the frames before would have it."""
    off = [_off(path, times, k) for k in range(FRAMES, len(path))]
    known = [x for x in off if np.isfinite(x)]
    return float(np.median(known)) if known else np.nan


def _off(path: np.ndarray, times: np.ndarray, frame: int) -> float:
    told = _line(path, times, np.arange(frame - FRAMES, frame), times[frame])
    return float(np.linalg.norm(path[frame] - told))


def _line(path: np.ndarray, times: np.ndarray, frames: np.ndarray, when: float) -> np.ndarray:
    """Where a straight line through some frames is at a time; NaN where they show too little."""
    seen = frames[np.isfinite(path[frames]).all(-1)]
    if len(seen) < FRAMES // 2:
        return np.full(path.shape[1], np.nan)
    return _lines(path, times, seen) @ [when - times[seen[0]], 1.0]


def _lines(path: np.ndarray, times: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Slope and place at the first of some frames, ``(d, 2)``."""
    since = times[seen] - times[seen[0]]
    return np.linalg.lstsq(np.column_stack([since, np.ones(len(seen))]), path[seen], rcond=None)[
        0
    ].T


def _nearest(pair: np.ndarray) -> list[int]:
    """Frames in which two bodies ``(t, 2, d)`` are nearest for a while, and nearly touch."""
    distance = np.linalg.norm(pair[:, 1] - pair[:, 0], axis=-1)
    if not np.isfinite(distance).any():
        return []
    near = np.nan_to_num(distance, nan=np.inf)
    least = np.sort(near[np.isfinite(near)])[: max(len(near) // 50, 3)].max()
    found: list[int] = []
    for frame in np.argsort(near):
        if near[frame] > NEAR * least:
            break
        if all(abs(frame - other) > 2 * MOST for other in found):
            found.append(int(frame))
    return found


def _leaves(
    pair: np.ndarray, times: np.ndarray, first: int, last: int, usual: np.ndarray
) -> int | None:
    """The first frame in which either of two bodies leaves its straight line."""
    for frame in range(first, last + 1):
        off = np.array([_off(pair[:, k], times, frame) for k in (0, 1)])
        if (off > SURELY * usual).any():
            return frame
    return None


def _exchanged(pair: np.ndarray, times: np.ndarray, begin: int, end: int) -> bool:
    """Whether two paths go on only if the names after a gap are exchanged."""
    before, after = np.arange(begin - FRAMES, begin), np.arange(end, end + FRAMES)
    moments = np.linspace(times[begin - 1], times[min(end, len(times) - 1)], 25)

    def gap(order: tuple[int, int]) -> float:
        return min(
            sum(
                float(
                    np.linalg.norm(
                        _line(pair[:, k], times, before, t) - _line(pair[:, other], times, after, t)
                    )
                )
                for k, other in enumerate(order)
            )
            for t in moments
        )

    return gap((1, 0)) < EXCHANGED * gap((0, 1))
