"""Times as they were written: rows twice, clocks too coarse, times that begin anew."""

from __future__ import annotations

import re

import numpy as np

COARSE = 0.1  # share of frames with the time of the frame before, from which a clock is coarse
CLOCK = re.compile(r"(\d+:)?\d+:\d+(\.\d*)?")  # hours, minutes and seconds
HUNDREDTHS = re.compile(r"(\d+:\d+:\d+):(\d\d)")  # of a second behind them, or frames
LEAST = 4  # rows of a trial, in the mean, that times which begin anew may tell
QUANTA = (1.0, 0.1, 0.01, 1e-3, 1e-4)  # seconds that times are rounded to, or cut off at
OFF = 0.75  # of one, that such a time is from an even one at most
ALONE = 0.8  # share of frames at least that follow the frame before
FINE = 0.01  # of an interval, below which rounding does no harm
TELLING = 8  # times that tell of rounding


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


def unrounded(times: np.ndarray) -> tuple[np.ndarray, float]:
    """Times that were even before they were written with few digits: the even ones.

    Args:
        times: seconds ``(t,)``; frames may be missing between them.

    Returns:
        The times, and to how many seconds they had been rounded; as they were, and 0, where that
        is not all that makes them uneven, and where they do not rise.
    """
    steps = np.diff(times)
    if len(times) < TELLING or not steps.min() > 0:
        return times, 0.0
    quantum = next((q for q in QUANTA if _whole(times / q)), 0.0)
    if quantum < FINE * np.median(steps):
        return times, 0.0
    for step in (float(np.median(steps)), float(steps.mean())):
        frames = np.concatenate([[0.0], np.cumsum(np.maximum(np.rint(steps / step), 1.0))])
        for _ in range(2):  # the second time by the slope of all of them
            slope, start = np.polyfit(frames, times, 1)
            frames = np.rint((times - start) / slope)
        late = np.abs(times - start - slope * frames).max()
        # frames that are a whole number of quanta apart are written as they are
        apart = np.abs(slope / quantum - np.rint(slope / quantum)) * np.ptp(frames)
        on = np.diff(frames)
        if on.min() >= 1 and (on == 1).mean() >= ALONE and late <= OFF * quantum and apart > 1:
            return times[0] + slope * (frames - frames[0]), quantum
    return times, 0.0


def _whole(numbers: np.ndarray) -> bool:
    return bool(np.abs(numbers - np.rint(numbers)).max(initial=0.0) < 1e-3)


def _spread(times: np.ndarray) -> np.ndarray:
    """Even times along the straight line of the coarse ones."""
    rows = np.arange(len(times))
    slope, start = np.polyfit(rows, times, 1)
    return start + slope * rows


def moments(words: np.ndarray) -> np.ndarray:
    """Seconds of dates or clock times (``2024-05-01 12:00:00.033``, ``0:01:02,5``, ``01:02.5``).

    A fourth number counts hundredths (``0:00:01:23``).

    Raises:
        ValueError: words that are no times, or whose fourth number counts frames.
    """
    text = [str(word).strip().replace("/", "-").replace(",", ".").rstrip("Z") for word in words]
    text = _of_hundredths(text)
    if all(CLOCK.fullmatch(word) for word in text):
        parts = [[float(part) for part in word.split(":")] for word in text]
        seconds = np.array([sum(x * 60**k for k, x in enumerate(p[::-1])) for p in parts])
        return seconds - seconds[0]
    stamps = np.array([word.replace(" ", "T", 1) for word in text], "datetime64[us]")
    return (stamps - stamps[0]).astype("timedelta64[us]").astype(float) * 1e-6


def _of_hundredths(text: list[str]) -> list[str]:
    """Clock times of four numbers, by three of which the last has hundredths; others as they are.

    Raises:
        ValueError: the last number goes up by one and stays low, as a count of frames does.
    """
    found = [HUNDREDTHS.fullmatch(word) for word in text]
    parts = [each.groups() for each in found if each is not None]
    if len(parts) < len(text) or not parts:
        return text
    last = np.array([int(part) for _, part in parts])
    if last.max() < 60 and (np.diff(last) == 1).mean() > 0.5:
        raise ValueError("the last of four numbers counts frames; give `interval` and leave it out")
    return [f"{clock}.{part}" for clock, part in parts]
