"""Meetings: instants at which two bodies near each other change their speeds against each other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.impacts.kinks import SIDES, WITHIN, Kinks, between_turns, kinks_of

COARSER, SIDES_OF_COARSER = (2, 4, 8, 16), (14, 20)  # frames that are averaged; sides of those
SPREAD = 35.0  # standard error of a change, where side, frame interval and noise are 1
SURE = 5.0  # standard errors of the change of their relative velocity
BOTH = 2.5  # of the change of each body's
AGAINST = -0.7  # cosine between the two changes, at most
ALONG = 0.7  # cosine between the change and the line of centres, at least
APART = 0.15  # of the range of their distances, within which bodies meet at the least distance
STUCK = 0.3  # of the closing speed, that may go on after a meeting by error


@dataclass(frozen=True)
class Meeting:
    """Two bodies that change each other's speed at once.

    Args:
        one, two: their numbers.
        time: seconds since the clip's first frame.
        places, before, after: of both, ``(2, d)``, places and velocities.
    """

    one: int
    two: int
    time: float
    places: np.ndarray
    before: np.ndarray
    after: np.ndarray

    @property
    def change(self) -> np.ndarray:
        """Of the velocities, ``(2, d)``."""
        return self.after - self.before

    @property
    def normal(self) -> np.ndarray:
        """Direction from the first to the second in which they were pushed apart, ``(d,)``."""
        pushed = self.change[1] - self.change[0]
        return pushed / np.linalg.norm(pushed)

    @property
    def distance(self) -> float:
        return float(np.linalg.norm(self.places[1] - self.places[0]))

    @property
    def restitution(self) -> float:
        """Parting speed over closing speed, between 0.05 and 1."""
        parting, closing = ((v[1] - v[0]) @ self.normal for v in (self.after, -self.before))
        return float(np.clip(parting / max(closing, np.finfo(float).tiny), 0.05, 1.0))


def meetings_of(clip: Frames) -> list[Meeting]:
    """All meetings of a clip's bodies, by time."""
    bodies = len(clip.stretches)
    pairs = [(i, j) for i in range(bodies) for j in range(i + 1, bodies)]
    found = [meeting for i, j in pairs for meeting in _of_pair(clip, i, j)]
    return sorted(found, key=lambda x: x.time)


def _of_pair(clip: Frames, one: int, two: int) -> list[Meeting]:
    """What the fewest frames tell first; longer sides tell what noise hides from those."""
    both, at, of = np.intersect1d(clip.seen[one], clip.seen[two], return_indices=True)
    if len(both) < 2 * SIDES[0] + 2:
        return []
    first, second = clip.stretches[one].places[at], clip.stretches[two].places[of]
    times, s = clip.times[both], np.concatenate([first, second], 1)
    longest = max(WITHIN * between_turns(s), SIDES[0])
    found: list[Meeting] = []
    for t, x, side, reach in _scales(times, s, longest):
        kinks = kinks_of(t, x, side)
        for window in _clear(kinks, x, float(np.median(np.diff(t)))):
            meeting = _meeting(kinks, t, window, one, two)
            if all(abs(meeting.time - other.time) > reach for other in found):
                found.append(meeting)
    return found


def _scales(
    times: np.ndarray, s: np.ndarray, longest: float
) -> Iterator[tuple[np.ndarray, np.ndarray, int, float]]:
    """Times, coordinates, frames on each side and seconds of those, ever coarser."""
    for many in (1, *COARSER):
        whole = len(times) // many * many
        t = times[:whole].reshape(-1, many).mean(1)
        x = s[:whole].reshape(-1, many, s.shape[1]).mean(1)
        for side in SIDES if many == 1 else SIDES_OF_COARSER:
            if len(t) < 2 * side + 2 or many * side > longest:
                return
            yield t, x, side, side * float(np.median(np.diff(t)))


def _clear(kinks: Kinks, s: np.ndarray, interval: float) -> list[int]:
    """Windows whose kink is a meeting, the clearest first."""
    place, before, _, change = (
        kinks.numbers[:, i].reshape(len(kinks.numbers), 2, -1) for i in range(4)
    )
    apart, pushed = place[:, 1] - place[:, 0], change[:, 1] - change[:, 0]
    closing = before[:, 0] - before[:, 1]
    sizes = np.linalg.norm(change, axis=-1)
    size, distance = np.linalg.norm(pushed, axis=-1), np.linalg.norm(apart, axis=-1)
    tiny = np.finfo(float).tiny
    against = (change[:, 0] * change[:, 1]).sum(-1) / np.maximum(sizes.prod(-1), tiny)
    along = (pushed * apart).sum(-1) / np.maximum(size * distance, tiny)
    normal = pushed / np.maximum(size, tiny)[:, None]
    approach = (closing * normal).sum(-1)
    error = SPREAD * kinks.sigma / interval / kinks.side**1.5
    half = s.shape[1] // 2
    distances = np.linalg.norm(s[:, half:] - s[:, :half], axis=-1)
    near = distance - distances.min() < APART * np.ptp(distances)
    clear = (
        (kinks.gain > 1)
        & (size > SURE * np.sqrt(2) * error)
        & (sizes.min(-1) > BOTH * error)
        & (against < AGAINST)
        & (along > ALONG if half > 1 else np.abs(along) > ALONG)
        & (approach > 0)
        & (size > (1 - STUCK) * approach)
        & near
    )
    strength = size / np.maximum(error, tiny) * np.log1p(kinks.gain)
    return sorted(np.flatnonzero(clear).tolist(), key=lambda w: -strength[w])


def _meeting(kinks: Kinks, times: np.ndarray, window: int, one: int, two: int) -> Meeting:
    place, before, _, change = kinks.numbers[window].reshape(4, 2, -1)
    last = window + kinks.side - 1
    time = float(times[last : last + 2].mean())
    return Meeting(one, two, time, place, before, before + change)
