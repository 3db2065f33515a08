"""The part of a recording in which one law holds, where none does in all of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.explanations.choice import Understood, understand
from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.explanations.verdict import ALL, AVERAGED, NOT
from vidphys.diagnose.mechanisms.impacts.kinks import impact_between
from vidphys.diagnose.mechanisms.mechanism import MOST_CLIPS, first_lawful
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion, Unseen
from vidphys.diagnose.recordings.units import Units
from vidphys.progress import Progress

LONG = 10  # frames in which nothing is seen, after which something else may be followed
FEWEST = 10  # frames that are fitted at least, where some are held out


@dataclass(frozen=True)
class Part:
    """Frames of a recording, and what they show.

    Args:
        motion: of them.
        first: of all frames, the one that they begin with.
        end: of their own, the first that nothing was fitted to.
        understood: what they show.
        then: what comes after them, which the law does not foretell; empty where nothing does.
    """

    motion: Motion
    first: int
    end: int
    understood: Understood
    then: str = ""


def understood_part(
    motion: Motion,
    hold_out: float,
    angles: bool = False,
    camera: bool = False,
    units: Units | None = None,
    progress: Progress | None = None,
) -> Part:
    """All of a recording, or a part of it if laws explain that and not the whole.

    Such a part is mostly explained at most: what was held out had a say in which part it is.

    Args:
        hold_out: share at the end of a long recording of few trials that nothing is fitted to.
        motion, angles, camera, units, progress: see `choice.understand`.

    Raises:
        Unseen: too little is seen of every part.
    """

    def asked(first: int, stop: int) -> Part:
        part = motion.cut(first, stop)
        end = _fitted(part, hold_out)
        return Part(part, first, end, understand(part, end, angles, camera, units, progress))

    total = motion.positions.shape[1]
    try:
        whole = asked(0, total)
    except Unseen:  # too little before the frames that are held out
        first = first_lawful(motion, angles)
        if not first:
            raise
        return _sought(asked(first + motion.cut(first).shown()[0], total))
    if whole.understood.status != NOT:
        return whole
    for first, stop, then in _lawful(whole, angles):
        try:
            part = _sought(asked(first, stop))
        except Unseen:  # too little of it is seen
            continue
        told = part.understood.explanation
        if part.understood.status != NOT and isinstance(told, ByMechanism):
            return replace(part, then=then)
    return whole


def _sought(part: Part) -> Part:
    """The same, told as one that was sought for a law to hold in it."""
    told = part.understood.explanation
    if not isinstance(told, ByMechanism):
        return part
    understood = replace(part.understood, explanation=replace(told, sought=True))
    return replace(part, understood=understood)


def _lawful(whole: Part, angles: bool) -> Iterator[tuple[int, int, str]]:
    """First frame of each part that a law may hold in, the one after the last, and what comes."""
    total = whole.motion.positions.shape[1]
    told = whole.understood.explanation
    if told is not None and (struck := _struck(whole)):
        yield told.first, struck, "an impact that the law does not foretell"
    if first := first_lawful(whole.motion, angles):
        yield first, total, ""
    for lost, again in _gaps(whole.motion):
        yield 0, lost, f"a gap of {again - lost} frames; what is seen later may be something else"


def _gaps(motion: Motion) -> list[tuple[int, int]]:
    """Of one clip: frames from which nothing is seen for long, and seen again; the last first."""
    if motion.clips > 1:
        return []
    seen = np.flatnonzero(motion.seen[0].any(-1))
    ends = [(int(a) + 1, int(b)) for a, b in zip(seen[:-1], seen[1:], strict=True)]
    return [(a, b) for a, b in reversed(ends) if b - a >= LONG and a >= FEWEST + LEAST_FRAMES]


def _struck(whole: Part) -> int:
    """The frame after the last one before an impact at which a good forecast fails, or 0."""
    motion, told = whole.motion, whole.understood.explanation
    verdict = None if told is None else told.verdict
    if verdict is None or not isinstance(told, ByMechanism) or motion.clips > 1:
        return 0
    if verdict.share < ALL or not verdict.horizon:
        return 0
    times, found = motion.times[0], 0
    fails = int(np.searchsorted(times, times[whole.end] + verdict.horizon)) + AVERAGED
    for body in range(motion.bodies):
        seen = np.flatnonzero(motion.seen[0, :, body])
        first, last = np.searchsorted(seen, [whole.end, fails])
        frame = impact_between(times[seen], motion.positions[0, seen, body], first, last)
        found = found if frame is None else max(found, int(seen[frame]) + 1)
    return found


def _fitted(motion: Motion, hold_out: float) -> int:
    """First frame that nothing is fitted to; all are where there would be too few."""
    total = motion.positions.shape[1]
    tail = max(int(hold_out * total), LEAST_FRAMES)
    some = motion.clips <= MOST_CLIPS and hold_out > 0 and total - tail >= FEWEST
    return total - tail if some else total
