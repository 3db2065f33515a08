"""Frames of a clip at even times: those of its own that are nearest to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vidphys.data.evenness import JITTER, jitter
from vidphys.data.frames import Frames, Source
from vidphys.data.video import Video
from vidphys.errors import InputError


def in_step(video: Video, rate: float | None, strides: int) -> Video:
    """A clip at the rate that was asked for; else itself, if its strides are even steps in time.

    Args:
        video, rate: see :func:`at_rate`.
        strides: see :func:`require_even`.

    Raises:
        InputError: see there.
    """
    if rate is not None:
        return at_rate(video, rate)
    require_even(video, strides)
    return video


def at_rate(video: Video, rate: float) -> Video:
    """Frames nearest to even times, each once, with the time stamps that they have.

    Args:
        video: whose frames may come at uneven times.
        rate: frames per second that are wanted; one that the clip does not have leaves gaps.

    Raises:
        InputError: no rate, or one above that of the clip.
    """
    if not rate > 0:
        raise InputError(f"resample {rate}: must be above 0 frames per second")
    times = video.times
    own = (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0
    if rate > own * (1 + JITTER):
        raise InputError(
            f"{video.path}: has {own:.4g} frames per second, `resample` asks for {rate:g}; frames "
            "that were not taken cannot be had"
        )
    wanted = times[0] + np.arange(int((times[-1] - times[0]) * rate + 1e-6) + 1) / rate
    after = np.searchsorted(times, wanted).clip(1, len(times) - 1)
    nearer = wanted - times[after - 1] <= times[after] - wanted
    chosen = np.unique(np.where(nearer, after - 1, after))
    kept = set(chosen.tolist())

    def again() -> Iterator[np.ndarray]:
        return (frame for number, frame in enumerate(video.frames) if number in kept)

    frames = Frames(Source(again, len(chosen), video.size))
    note = f"{len(chosen)} of {len(times)} frames, nearest to {rate:g} per second"
    notes = (*video.notes, note)
    return replace(
        video, frames=frames, times=times[chosen], indices=video.indices[chosen], notes=notes
    )


def require_even(video: Video, strides: int) -> None:
    """Refuse to take each so-many-th frame of a clip whose frames come at uneven times.

    Args:
        video: the frames that were taken.
        strides: of frames, as asked for; 1 takes them all, at the times that they have.

    Raises:
        InputError: frames are early or late by more than two hundredths of an interval.
    """
    found = jitter(video.times)
    if strides > 1 and found > JITTER:
        raise InputError(
            f"{video.path}: frames come up to {100 * found:.0f} % of an interval early or late, so "
            "that each so-many-th is no even step in time; give `resample` in frames per second in "
            "place of `stride`"
        )
