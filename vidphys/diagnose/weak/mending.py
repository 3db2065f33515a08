"""Tracks mended before anything is fitted to them: false finds become gaps, swapped names go back.

A false find is a frame that neither those before it, nor those after it, nor both together
foretell (Hampel's filter, about local polynomials instead of the median, and one-sided as well:
a contact is foretold by one of its sides). Names were swapped where two bodies' tracks are smooth
if they are exchanged from a frame on, and are not as they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

SIDE = 4  # frames before or after a frame, by which it is foretold
DEGREE = 2
BENDS = (2, 4)  # degrees across a meeting of two bodies: a gentle one and a sharp one
BY_BOTH, BY_ONE = 8.0, 5.0  # robust standard deviations, beyond which a frame is foretold by none
SPIKE = 2.0  # of the same, up to which the rest of a track is smooth
ROUNDS = 4  # a false find spoils what its neighbours are foretold by
PASSES = 3
GROSS = 0.1  # of a body's spread, from which a false find is far off
SINGULAR = 1e-6  # of a frame's own residual, below which nothing else says where it should be
NEAR = 2  # frames within which one round takes out only the worst
SMOOTH, JUMPS = 7.0, 20.0  # of a usual misfit: exchanged tracks leave less, tracks as they are more


@dataclass(frozen=True)
class Mended:
    """Tracks, and what was done to them.

    Args:
        motion: false finds are unseen, names stay with their bodies.
        false_finds: frames of a body that were taken out.
        swaps: names that were exchanged from some frame on.
    """

    motion: Motion
    false_finds: int
    swaps: int

    @property
    def said(self) -> list[str]:
        """A sentence, where anything was done."""
        done = []
        if self.false_finds:
            frames = "1 frame" if self.false_finds == 1 else f"{self.false_finds} frames"
            done.append(f"{frames} of a body fit none of their neighbours and are left out")
        if self.swaps:
            times = "once" if self.swaps == 1 else f"{self.swaps} times"
            done.append(f"names of two bodies were exchanged {times}")
        return [f"The tracks were mended: {'; '.join(done)}."] if done else []


def mend(motion: Motion) -> Mended:
    """Take out false finds, and give bodies their names back."""
    q = motion.positions.copy()
    found = swaps = 0
    for _ in range(PASSES):  # names first: where they change, true finds look false
        named, gone = _with_own_names(q, motion.times), _without_false_finds(q, motion.times)
        found, swaps = found + gone, swaps + named
        if not gone:
            break
    if not found and not swaps:
        return Mended(motion, 0, 0)
    return Mended(replace(motion, positions=q), found, swaps)


def without_outliers(motion: Motion) -> Mended:
    """Take out false finds that are far off, by which laws of whole recordings would be bent.

    Smaller ones, as those of a coarse scale, do them no harm. Where names were exchanged too, what
    was followed is left as it is.
    """
    mended = mend(motion)
    if mended.swaps or not mended.false_finds:
        return Mended(motion, 0, 0)
    q, kept = motion.positions.copy(), mended.motion.seen
    gone = motion.seen & ~kept
    for clip, body in np.argwhere(gone.any(1)):
        there, times = kept[clip, :, body], motion.times[clip]
        missed, path = np.flatnonzero(gone[clip, :, body]), q[clip, there, body]
        between = [np.interp(times[missed], times[there], x) for x in path.T]
        off = np.linalg.norm(q[clip, missed, body].T - between, axis=0)
        q[clip, missed[off > GROSS * np.linalg.norm(path.std(0))], body] = np.nan
    found = int(motion.seen.sum() - np.isfinite(q).all(-1).sum())
    return Mended(replace(motion, positions=q), found, 0)


def _foretold(t: np.ndarray, x: np.ndarray, at: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Errors ``(k,)`` of frames ``at`` by a polynomial through frames ``near``, ``(k, m)``."""
    since = (t[near] - t[at][:, None]) / (t[1] - t[0])
    design = since[..., None] ** np.arange(DEGREE + 1)
    constant = np.linalg.pinv(design)[:, 0]  # the value at the frame itself
    return np.linalg.norm(x[at] - (constant[..., None] * x[near]).sum(1), axis=-1)


def _errors(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """By the frames before, after, and about each, ``(3, t)``; infinite where there are too few."""
    count = len(t)
    out = np.full((3, count), np.inf)
    frames, step = np.arange(count), np.arange(1, SIDE + 1)
    half = np.concatenate([-step[: SIDE // 2], step[: SIDE // 2]])
    for row, reach in enumerate((-step, step, half)):
        at = frames[(frames + reach.min() >= 0) & (frames + reach.max() < count)]
        out[row, at] = _foretold(t, x, at, at[:, None] + reach)
    return out


def _smooth_without(t: np.ndarray, x: np.ndarray, frame: int, usual: float) -> bool:
    """Whether a track is smooth where one frame is left out, with one of its neighbours perhaps.

    Where a body turns sharply it is not, and no frame of it is a false find.
    """
    near = np.arange(max(0, frame - SIDE + 1), min(len(t), frame + SIDE))
    near = near[near != frame]
    for left_out in (None, *near):
        some = near[near != left_out] if left_out is not None else near
        design = ((t[some] - t[frame]) / (t[1] - t[0]))[:, None] ** np.arange(DEGREE + 1)
        rest = x[some] - design @ (np.linalg.pinv(design) @ x[some])
        if np.sqrt((rest**2).sum() / max(len(some) - DEGREE - 1, 1)) < SPIKE * usual:
            return True
    return False


def _without_false_finds(q: np.ndarray, times: np.ndarray) -> int:
    """Unsee false finds in ``q``, in place; how many."""
    found = 0
    for _ in range(ROUNDS):
        errors = np.full((3, *q.shape[:3]), np.inf)
        for clip, body in np.ndindex(q.shape[0], q.shape[2]):
            there = np.flatnonzero(np.isfinite(q[clip, :, body]).all(-1))
            if len(there) > 2 * SIDE:
                own = _errors(times[clip, there], q[clip, there, body])
                errors[:, clip, there, body] = own
        seen = np.isfinite(q).all(-1)
        limits = np.array([BY_ONE, BY_ONE, BY_BOTH])
        usual = np.array([_usual_errors(e) for e in errors])
        worst = np.ones(q.shape[:3], bool) & seen
        size = np.zeros(q.shape[:3])
        for error, most, scale in zip(errors, limits, usual, strict=True):
            known = np.isfinite(error)
            scale = np.maximum(scale, np.finfo(float).tiny)
            worst &= ~known | (error > most * scale)
            size = np.maximum(size, np.where(known, error / scale, 0.0))
        worst &= np.isfinite(errors).any(0)
        for clip, frame, body in np.argwhere(worst):
            there = np.flatnonzero(seen[clip, :, body])
            worst[clip, frame, body] = _smooth_without(
                times[clip, there], q[clip, there, body], int((there < frame).sum()), usual[2, body]
            )
        size = np.where(worst, size, 0.0)
        for shift in range(1, NEAR + 1):
            worst[:, shift:] &= size[:, shift:] >= size[:, :-shift]
            worst[:, :-shift] &= size[:, :-shift] >= size[:, shift:]
        if not worst.any():
            break
        q[worst] = np.nan
        found += int(worst.sum())
    return found


def _usual_errors(errors: np.ndarray) -> np.ndarray:
    """Of each body ``(n,)``, of errors ``(c, t, n)``: its own, or that of all where it is larger.

    A body that is faster than the others is foretold less well, where all are seen exactly.
    """
    each = [*np.moveaxis(errors, 2, 0), errors]
    *own, all_ = (np.median(e[np.isfinite(e)]) if np.isfinite(e).any() else np.inf for e in each)
    return np.array([max(x, all_) if np.isfinite(x) else all_ for x in own])


def _with_own_names(q: np.ndarray, times: np.ndarray) -> int:
    """Exchange names in ``q`` back, in place; how often."""
    swaps = 0
    for clip in range(len(q)):
        tracks, seen = q[clip], np.isfinite(q[clip]).all(-1)
        usual = {bend: _usual(tracks, times[clip], seen, bend) for bend in BENDS}
        done: set[tuple[int, int, int]] = set()
        while True:
            likely = [
                _likeliest_swap(tracks, times[clip], seen, usual[bend], done, bend)
                for bend in BENDS
            ]
            gain, found = max(likely)
            if not gain:
                break
            frame, i, j = found
            tracks[frame:, [i, j]] = tracks[frame:, [j, i]]
            seen[frame:, [i, j]] = seen[frame:, [j, i]]
            done.add(found)
            swaps += 1
    return swaps


def _usual(tracks: np.ndarray, times: np.ndarray, seen: np.ndarray, bend: int) -> float:
    """The misfit that bodies' own tracks usually have across a frame."""
    own = [_misfits(tracks, times, seen, body, body, bend) for body in range(tracks.shape[1])]
    misfit = np.concatenate(own)
    misfit = misfit[np.isfinite(misfit)]
    return float(np.median(misfit)) if len(misfit) else np.inf


def _likeliest_swap(
    tracks: np.ndarray,
    times: np.ndarray,
    seen: np.ndarray,
    usual: float,
    done: set[tuple[int, int, int]],
    bend: int,
) -> tuple[float, tuple[int, int, int]]:
    """How much smoother an exchange makes two tracks, and its first frame and bodies; 0 if none."""
    best, gain = (0, 0, 0), 0.0
    own = [_misfits(tracks, times, seen, body, body, bend) for body in range(tracks.shape[1])]
    for i, j in combinations(range(tracks.shape[1]), 2):
        kept = own[i] + own[j]
        if not (kept > JUMPS * usual).any():
            continue
        each = [_misfits(tracks, times, seen, *two, bend) for two in ((i, j), (j, i))]
        other = each[0] + each[1]
        smooth = (kept > JUMPS * usual) & (other < np.maximum(SMOOTH * usual, 0.02 * kept))
        smooth &= np.isfinite(kept) & np.isfinite(other)
        for frame in np.flatnonzero(smooth):
            ratio = float(kept[frame] / max(other[frame] + usual, np.finfo(float).tiny))
            if ratio > gain and (int(frame) + 1, i, j) not in done:
                best, gain = (int(frame) + 1, i, j), ratio
    return gain, best


def _misfits(
    tracks: np.ndarray, times: np.ndarray, seen: np.ndarray, before: int, after: int, bend: int
) -> np.ndarray:
    """Misfit ``(t - 1,)`` of one polynomial to a body before each frame and one from it on.

    It is of the degree ``bend``. The frame that fits it worst is left out, as it may be a false
    find. NaN where too few frames show either.
    """
    frames = len(times)
    out = np.full(frames - 1, np.nan)
    first, second = np.flatnonzero(seen[:, before]), np.flatnonzero(seen[:, after])
    past = np.searchsorted(first, np.arange(1, frames))  # how many are seen before the frame
    next_ = np.searchsorted(second, np.arange(1, frames))
    at = np.flatnonzero((past >= SIDE) & (next_ + SIDE <= len(second)))
    if not len(at):
        return out
    step = np.arange(SIDE)
    left = first[past[at][:, None] - SIDE + step]
    right = second[next_[at][:, None] + step]
    both = np.concatenate([left, right], 1)
    x = np.concatenate([tracks[left, before], tracks[right, after]], 1)
    since = (times[both] - times[at][:, None]) / (times[1] - times[0])
    design = since[..., None] ** np.arange(bend + 1)
    x = x - x.mean(1, keepdims=True)
    hat = design @ np.linalg.pinv(design)
    left_over = ((x - hat @ x) ** 2).sum(2)
    own = 1 - np.einsum("kii->ki", hat)  # of its residual, what a frame did not pull away itself
    out[at] = left_over.sum(1) - (left_over / np.maximum(own, SINGULAR)).max(1)
    return out
