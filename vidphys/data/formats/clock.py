"""What rows of a table are in order by: times in seconds, or numbers of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.data.formats.columns import Columns, Table, numbers_of
from vidphys.data.formats.names import SECONDS
from vidphys.data.formats.stamps import moments
from vidphys.errors import InputError

RATES = (23.976, 24.0, 29.97, 30.0, 48.0, 59.94, 60.0, 119.88, 120.0, 239.76, 240.0)  # of films
NEAR = 5e-4  # of one; two that are called alike are 1e-3 apart
MILLISECONDS = (5, 2000)  # whole numbers that step by so many are no seconds
LONG_AGO = 1e9  # seconds, from which times are dates, or since 1970
EPOCHS = {"ns": (1e17, 1e-9), "µs": (1e14, 1e-6), "ms": (1e11, 1e-3)}  # since 1970, from so many on


@dataclass(frozen=True)
class Clock:
    """What rows are in order by, ``(rows,)``; whether it is seconds; and what it was, in words."""

    values: np.ndarray
    seconds: bool
    said: str


def clock_of(table: Table, columns: Columns, interval: float | None) -> Clock:
    """What the rows of a table are in order by.

    Args:
        table, columns: its columns, and what they are.
        interval: seconds of a frame or a row; ``None`` where it is not known.

    Raises:
        InputError: a column of times that are none.
    """
    if columns.time is not None:
        return _seconds(table, columns.time, columns.units.get(columns.time, ""), interval)
    if columns.frame is not None:
        numbers, said = numbers_of(table, columns.frame), columns.frame
    else:
        numbers, said = _counted(table, columns), "the row"
    if interval is None:
        return Clock(numbers, False, said)
    return Clock(numbers * interval, True, f"{said} times the interval")


def _counted(table: Table, columns: Columns) -> np.ndarray:
    """The number of each row, among those of its clip and body."""
    count = len(next(iter(table.values())))
    told = [np.unique(table[n], return_inverse=True)[1] for n in (columns.clip, columns.body) if n]
    whose = np.unique(np.array(told).T, axis=0, return_inverse=True)[1] if told else np.zeros(count)
    numbers = np.empty(count, int)
    for one in np.unique(whose):
        numbers[whose == one] = np.arange((whose == one).sum())
    return numbers


def _seconds(table: Table, name: str, unit: str, interval: float | None) -> Clock:
    values = table[name]
    if values.dtype.kind in "USOM":
        try:
            return Clock(moments(values), True, f"{name}, of a clock")
        except ValueError as error:
            raise InputError(f"column {name}: not times ({error})") from error
    times = numbers_of(table, name)
    known = times[np.isfinite(times)]
    if unit in SECONDS:
        said = name if SECONDS[unit] == 1 else f"{name}, from {unit} to s"
        if len(known) and known.min() * SECONDS[unit] > LONG_AGO:
            return Clock((times - known.min()) * SECONDS[unit], True, f"{said} since the first")
        return Clock(times * SECONDS[unit], True, said)
    whole = len(known) > 1 and bool((known == np.round(known)).all())
    steps = np.diff(np.unique(known))
    if not len(steps):
        return Clock(times, True, name)
    rate = _rate(1e3 / float(steps.mean()))
    if rate:
        said = f"{name}, taken for ms: its steps are those of {rate:g} frames a second"
        return Clock(times * 1e-3, True, said)
    if not whole:
        return Clock(times, True, name)
    step = float(np.median(steps))
    if interval is not None and step == 1:
        return Clock(times * interval, True, f"{name}, whole numbers, times the interval")
    for unit, (least, second) in EPOCHS.items():
        if known.min() > least:
            return Clock((times - known.min()) * second, True, f"{name}, in {unit} since 1970")
    if MILLISECONDS[0] <= step <= MILLISECONDS[1]:
        return Clock(times * 1e-3, True, f"{name}, whole numbers, taken for ms")
    return Clock(times, True, f"{name}, whole numbers, taken for s (frames? give `interval`)")


def _rate(frames: float) -> float:
    """The rate of films that this is near, of those whose frames last no whole milliseconds; or 0.

    A clock in seconds has no steps like these.
    """
    near = [rate for rate in RATES if abs(frames / rate - 1) < NEAR]
    return min(near, key=lambda rate: abs(frames - rate), default=0.0)
