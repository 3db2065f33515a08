"""Times as they were written: rows twice, clocks too coarse, times that begin anew."""

from __future__ import annotations

import re

import numpy as np

COARSE = 0.1  # share of frames with the time of the frame before, from which a clock is coarse
CLOCK = re.compile(r"(\d+:)?\d+:\d+(\.\d*)?")  # hours, minutes and seconds
LEAST = 4  # rows of a trial, in the mean, that times which begin anew may tell


def restarts(times: np.ndarray) -> np.ndarray | None:
    """Number of the trial of each row, where times go back to begin anew; else ``None``.

    Args:
        times: of the rows, in their order, ``(rows,)``.
    """
    back = np.diff(times) < 0
    pieces = np.concatenate([[0], np.cumsum(back)])
    if not back.any() or len(times) < LEAST * (pieces[-1] + 1):
        return None
    starts = np.flatnonzero(np.concatenate([[True], back]))
    ends = np.concatenate([starts[1:], [len(times)]]) - 1
    spans = sorted(zip(times[starts], times[ends], strict=True))
    apart = all(one[1] < two[0] for one, two in zip(spans, spans[1:], strict=False))
    return None if apart else pieces


def cleaned(
    times: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Rows of one clip with times that increase.

    Rows without a time or with the time of the row before are left out; where that is many, the
    clock is coarser than the frames, which are then spread evenly.

    Args:
        times: sorted, ``(t,)``.
        places: ``(t, n, d)``.

    Returns:
        Both, and what was done, a line each.
    """
    notes = []
    known = np.isfinite(times)
    if not known.all():
        notes.append(f"{(~known).sum()} rows without a time left out")
        times, places = times[known], places[known]
    again = np.concatenate([[False], np.diff(times) <= 0])
    if not again.any() or again[1:].all():
        return times, places, tuple(notes)
    same = np.zeros_like(again)
    same[1:] = ((places[1:] == places[:-1]) | np.isnan(places[1:])).all((1, 2))
    if (again & ~same).mean() > COARSE:
        notes.append(
            f"{again.sum()} of {len(times)} times repeat the one before: the clock is coarser than "
            "the frames, which were spread evenly"
        )
        return _spread(times), places, tuple(notes)
    notes.append(f"{again.sum()} rows with the time of the row before left out")
    return times[~again], places[~again], tuple(notes)


def _spread(times: np.ndarray) -> np.ndarray:
    """Even times along the straight line of the coarse ones."""
    rows = np.arange(len(times))
    slope, start = np.polyfit(rows, times, 1)
    return start + slope * rows


def moments(words: np.ndarray) -> np.ndarray:
    """Seconds of dates or clock times (``2024-05-01 12:00:00.033``, ``0:01:02,5``, ``01:02.5``).

    Raises:
        ValueError: words that are no times.
    """
    text = [str(word).strip().replace("/", "-").replace(",", ".").rstrip("Z") for word in words]
    if all(CLOCK.fullmatch(word) for word in text):
        parts = [[float(part) for part in word.split(":")] for word in text]
        seconds = np.array([sum(x * 60**k for k, x in enumerate(p[::-1])) for p in parts])
        return seconds - seconds[0]
    stamps = np.array([word.replace(" ", "T", 1) for word in text], "datetime64[us]")
    return (stamps - stamps[0]).astype("timedelta64[us]").astype(float) * 1e-6
