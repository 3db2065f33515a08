"""What a column of numbers is by its shape: rising times, numbers of trials, rates of others."""

from __future__ import annotations

import numpy as np

FEW = 0.125  # share of the rows at which times may begin anew
ALIKE = 0.98  # correlation of an integrated rate with what it is the rate of
SAME = 0.2  # by which its size may differ
NUMBERS = "fiub"  # kinds of columns


def rising(values: np.ndarray) -> bool:
    """Whether numbers rise, but for a few restarts, and are never missing; words do not."""
    if values.dtype.kind not in NUMBERS:
        return False
    x = np.asarray(values, float)
    if len(x) < 3 or not np.isfinite(x).all():
        return False
    steps = np.diff(x)
    return bool((steps > 0).mean() > 1 - FEW and (steps > 0).sum() > (steps == 0).sum())


def numbers_trials(values: np.ndarray) -> bool:
    """Whether numbers are whole, and stay for many rows before they change; words are none."""
    if values.dtype.kind not in NUMBERS:
        return False
    x = np.asarray(values, float)
    if not np.isfinite(x).all() or not (x == np.round(x)).all():
        return False
    changes = int((np.diff(x) != 0).sum())
    return changes <= FEW * len(x) and len(np.unique(x)) == changes + 1


def is_rate_of(rate: np.ndarray, place: np.ndarray, times: np.ndarray) -> bool:
    """Whether one column, integrated over time, is another; steady drifts apart.

    Args:
        rate, place, times: ``(rows,)``.
    """
    rate, place, times = (np.asarray(x, float) for x in (rate, place, times))
    good = np.isfinite(rate) & np.isfinite(place) & np.isfinite(times)
    rate, place, times = rate[good], place[good], times[good]
    if len(times) < 8:
        return False
    steps = np.diff(times)
    moved = np.where(steps > 0, 0.5 * (rate[1:] + rate[:-1]) * steps, np.nan)
    went = np.where(steps > 0, np.diff(place), np.nan)
    a, b = (_gone(x) for x in (moved, went))
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if not size > 0:
        return False
    slope = float(a @ b) / float(a @ a)
    return bool(a @ b / size > ALIKE and abs(slope - 1) < SAME)


def _gone(steps: np.ndarray) -> np.ndarray:
    """Steps added up, without their straight line."""
    path = np.cumsum(np.nan_to_num(steps))
    t = np.linspace(-1, 1, len(path))
    basis = np.linalg.qr(np.stack([np.ones_like(t), t], -1))[0]
    return path - basis @ (basis.T @ path)
