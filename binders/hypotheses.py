"""What can be followed through a clip, by least acceleration and steady looks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from binders.blobs import Blobs

REACH = 2.0  # sizes
LEAST_REACH = 2.0  # pixels
LONGEST_COAST = 5  # frames in a row in which a body that is not seen goes on
FAINT = 0.15
SMOOTH = 0.35  # acceleration, of the speed, up to which three blobs in a row begin a body
ODD = 1.5  # cost of a beginning, beyond which it is none
BEGINNINGS = 4  # of a frame
STARTS = 8  # parts of the clip in which one is tried to begin at its strongest blob
FEWEST = 4  # frames in which one is seen after it was lost, or it is another
ENDS = 3  # frames that are looked at there
SMOOTHED = 5  # frames beside them that they are to go with
CUT = 0.94  # of its size, below which part of it is hidden or outside the picture
BENT = 0.3  # of the way of a frame, by which they may be off it
HYPOTHESES = 24

Beginning = tuple[int, int, np.ndarray]  # frame, blob, speed in pixels a frame


@dataclass(frozen=True)
class Hypothesis:
    """Something that was followed and may be a body.

    Args:
        positions: ``(t, 2)`` pixels; NaN where it was not seen.
        energy, size, radius, compact, lit: of its blob, as in :class:`Blobs`, ``(t,)``; NaN where
            no blob shows it.
        colour: ``(t, 3)``.
        cornered: whether corners that move as one tell its places, not the middle of a blob.
    """

    positions: Float[np.ndarray, "t 2"]
    energy: Float[np.ndarray, " t"]
    size: Float[np.ndarray, " t"]
    radius: Float[np.ndarray, " t"]
    colour: Float[np.ndarray, "t 3"]
    compact: Float[np.ndarray, " t"]
    lit: Float[np.ndarray, " t"]
    cornered: bool = field(default=False, kw_only=True)

    @property
    def seen(self) -> np.ndarray:
        """Whether it was seen, ``(t,)`` boolean."""
        return np.isfinite(self.positions[:, 0])

    @cached_property
    def usual_size(self) -> float:
        """Median of the sizes; it is asked for with every other hypothesis."""
        return float(np.nanmedian(self.size))


def hypotheses(blobs: list[Blobs], times: Float[np.ndarray, " t"]) -> list[Hypothesis]:
    """What can be followed, each by a blob of a frame; several may share blobs.

    Three blobs in a row that look alike and lie on a smooth way begin one; it goes to both ends
    of the clip by the blob nearest to where it would be without acceleration, within a reach of
    two sizes plus twice what it has moved since it was seen (it may bounce), that looks like it.

    Args:
        blobs: of each frame.
        times: of each frame, in units of the usual interval.
    """
    claimed = [np.zeros(len(b), bool) for b in blobs]
    found: list[Hypothesis] = []
    for frame, first, speed in _beginnings(blobs, times):
        if claimed[frame][first]:
            continue
        chosen = np.full(len(blobs), -1)
        chosen[frame] = first
        _walk(blobs, times, chosen, range(frame + 1, len(blobs)), speed)
        _walk(blobs, times, chosen, range(frame - 1, -1, -1), -speed)
        _drop_faint(blobs, chosen)
        _drop_glimpses(chosen)
        _drop_ends(blobs, times, chosen)
        for t in np.nonzero(chosen >= 0)[0]:
            claimed[t][chosen[t]] = True
        found.append(_gathered(blobs, chosen))
        if len(found) == HYPOTHESES:
            break
    return found


def _beginnings(blobs: list[Blobs], times: np.ndarray) -> Iterator[Beginning]:
    """Three blobs on a smooth way, the clearest first; then each part's strongest blob, at rest."""
    found = [
        each for t in range(1, len(blobs) - 1) for each in _threes(blobs[t - 1 : t + 2], times, t)
    ]
    for _, beginning in sorted(found, key=lambda each: each[0]):
        yield beginning
    for part in np.array_split(range(len(blobs)), min(STARTS, len(blobs))):
        strongest = [(float(blobs[t].energy.max()), int(t)) for t in part if len(blobs[t])]
        if strongest:
            _, t = max(strongest)
            yield t, int(blobs[t].energy.argmax()), np.zeros(2)


def _threes(blobs: list[Blobs], times: np.ndarray, t: int) -> Iterator[tuple[float, Beginning]]:
    """Beginnings at frame ``t``, the middle of three, each with its cost less its strength."""
    before, here, after = blobs
    if not (len(before) and len(here) and len(after)):
        return
    out = (after.centre - here.centre[:, None]) / (times[t + 1] - times[t])
    back = (here.centre[:, None] - before.centre) / (times[t] - times[t - 1])
    speed = (out[:, None] + back[:, :, None]) / 2  # (here, before, after)
    turn = np.linalg.norm(out[:, None] - back[:, :, None], axis=-1)
    cost = turn / (1 + 0.5 * here.size[:, None, None] + SMOOTH * np.linalg.norm(speed, axis=-1))
    cost = cost + before.unlike(here.colour, here.size)[:, :, None]
    cost = cost + after.unlike(here.colour, here.size)[:, None]
    strong = here.energy * here.compact**2
    order = np.argsort(cost.min((1, 2)) - np.sqrt(strong / strong.max()))
    for i in order[:BEGINNINGS]:
        j, k = np.unravel_index(cost[i].argmin(), cost[i].shape)
        if cost[i, j, k] < ODD:
            yield float(cost[i, j, k] - np.log(strong[i])), (t, int(i), speed[i, j, k])


def _walk(
    blobs: list[Blobs], times: np.ndarray, chosen: np.ndarray, order: range, speed: np.ndarray
) -> None:
    """Fill ``chosen`` frame by frame in ``order``; -1 where there is no blob of the body."""
    before = order.start - order.step
    first, k = blobs[before], chosen[before]
    here, size, colour, usual = first.centre[k], first.size[k], first.colour[k], first.energy[k]
    fastest, unseen = float(np.linalg.norm(speed)), 0
    for frame in order:
        step = abs(times[frame] - times[before])
        before = frame
        here = here + step * speed
        if unseen <= LONGEST_COAST:
            fastest = float(np.linalg.norm(speed))
        reach = LEAST_REACH + REACH * size + 2 * fastest * (step + unseen)
        now = blobs[frame]
        best = _nearest(now, here, reach, FAINT * usual, colour, size)
        chosen[frame] = best
        if best < 0:
            unseen += 1
            if unseen > LONGEST_COAST:
                speed = np.zeros(2)
            continue
        new = now.centre[best]
        speed = speed + (new - here) / (step + unseen)
        here, unseen = new, 0
        usual = 0.9 * usual + 0.1 * now.energy[best]
        size = size**0.8 * now.size[best] ** 0.2
        colour = 0.8 * colour + 0.2 * now.colour[best]


def _nearest(
    blobs: Blobs,
    predicted: np.ndarray,
    reach: float,
    faintest: float,
    colour: np.ndarray,
    size: float,
) -> int:
    """The body's blob, or -1: distance over reach, and how unlike it looks."""
    if not len(blobs):
        return -1
    distance = np.linalg.norm(blobs.centre - predicted, axis=-1) / reach
    unlike = blobs.unlike(colour, size)
    out = (distance > 1) | (blobs.energy < faintest) | (unlike > 1)
    cost = distance + 0.5 * unlike - 0.3 * blobs.energy / blobs.energy.max()
    best = int(np.where(out, np.inf, cost).argmin())
    return -1 if out[best] else best


def _drop_faint(blobs: list[Blobs], chosen: np.ndarray) -> None:
    """Forget what is far fainter than the body usually is."""
    seen = np.nonzero(chosen >= 0)[0]
    energy = np.array([blobs[t].energy[chosen[t]] for t in seen])
    chosen[seen[energy < FAINT * np.median(energy)]] = -1


def _drop_glimpses(chosen: np.ndarray) -> None:
    """Forget what is seen for a few frames only, long before or after the rest."""
    seen = np.nonzero(chosen >= 0)[0]
    runs = np.split(seen, np.nonzero(np.diff(seen) > LONGEST_COAST + 1)[0] + 1)
    longest = max(map(len, runs))
    for run in runs:
        if len(run) < min(FEWEST, longest):
            chosen[run] = -1


def _drop_ends(blobs: list[Blobs], times: np.ndarray, chosen: np.ndarray) -> None:
    """Forget the first and last frames where they do not go with those beside them."""
    for way in (1, -1):
        seen = np.nonzero(chosen >= 0)[0][::way]
        for n in range(min(ENDS, len(seen) - SMOOTHED)):
            near = seen[n : n + 1 + SMOOTHED]
            centre = np.array([blobs[t].centre[chosen[t]] for t in near])
            since = times[near] - times[near[0]]
            fit, (left, *_) = np.polynomial.polynomial.polyfit(since[1:], centre[1:], 2, full=True)
            speed = np.linalg.norm(centre[1] - centre[2]) / abs(since[1] - since[2])
            size = np.array([blobs[t].size[chosen[t]] for t in near])
            off = float(np.linalg.norm(fit[0] - centre[0])) - 3 * np.sqrt(np.sum(left))
            whole = size[0] > CUT * np.median(size[1:])
            if off < (LEAST_REACH + size[0] + BENT * speed if whole else 1.0):
                break
            chosen[near[0]] = -1


def _gathered(blobs: list[Blobs], chosen: np.ndarray) -> Hypothesis:
    def column(values: list[np.ndarray]) -> np.ndarray:
        width = next(v.shape[1:] for v in values)
        nothing = np.full(width, np.nan)
        return np.array([v[k] if k >= 0 else nothing for v, k in zip(values, chosen, strict=True)])

    names = ("centre", "energy", "size", "radius", "colour", "compact", "lit")
    return Hypothesis(*(column([getattr(b, name) for b in blobs]) for name in names))
