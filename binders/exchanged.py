"""Bodies that were taken for one another where they met, and one that was followed in parts."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float

from binders.blobs import GROWN, RECOLOURED
from binders.hypotheses import LEAST_REACH, REACH, Hypothesis

MET = 1.5  # times the sum of their sizes, within which they may be exchanged
LOOKED_AT = 20  # frames before and after, that tell their looks
FEWEST = 3
EDGE = 5  # frames about the first and the last that two share: there one is not yet the other
TOUCH = 0.5  # pixels, within which two are at one place
SHARED = 5  # frames, in which two that were begun apart are at one place, if they are one body
SURE = 0.15  # of what one body may differ from itself, by which the exchange must fit better
LOST = 10.0  # usual intervals, for which one is not seen between two of its parts, at most
ALIKE = 0.5  # of what one body may differ from itself, the most that its parts do


def apart(bodies: list[Hypothesis]) -> list[Hypothesis]:
    """The bodies, likeliest first, no two at one place: a blob shows one body.

    Where two are together, it is the one that looks so elsewhere, or else the likelier.
    """
    kept: list[Hypothesis] = []
    for body in bodies:
        for n, other in enumerate(kept):
            away = np.linalg.norm(body.positions - other.positions, axis=-1)
            together = away < 0.5 * np.nanmedian(body.radius)
            if _looks_more_so(body, other, together):
                kept[n] = _without(other, np.convolve(together, np.ones(EDGE), "same") > 0)
            else:
                body = _without(body, together)
        kept.append(body)
    return kept


def _looks_more_so(one: Hypothesis, other: Hypothesis, together: np.ndarray) -> bool:
    """Whether what is seen where two are together looks as the one does elsewhere, surely."""
    shown = _looks(one, together)
    own, others = (_looks(x, x.seen & ~together) for x in (one, other))
    if shown is None or own is None or others is None:
        return False
    return bool(np.linalg.norm(shown - own) + SURE < np.linalg.norm(shown - others))


def _without(body: Hypothesis, frames: np.ndarray) -> Hypothesis:
    return replace(body, positions=np.where(frames[:, None], np.nan, body.positions))


def told_apart(bodies: list[Hypothesis]) -> list[Hypothesis]:
    """The same bodies, exchanged from a meeting on where they look so."""
    bodies = list(bodies)
    for one, other in combinations(range(len(bodies)), 2):
        for first, last in _meetings(bodies[one], bodies[other]):
            if _exchanged(bodies[one], bodies[other], first, last):
                middle = (first + last + 1) // 2
                bodies[one], bodies[other] = (
                    _joined(bodies[one], bodies[other], middle),
                    _joined(bodies[other], bodies[one], middle),
                )
    return bodies


def crossed(bodies: list[Hypothesis]) -> list[Hypothesis]:
    """Each that is begun as one and ended as another, of two that go one way for a while.

    What was followed from its middle may be lost to a hand at one end, and what was followed from
    elsewhere at the other.
    """
    joined = []
    for one, other in combinations(bodies, 2):
        away = np.linalg.norm(one.positions - other.positions, axis=-1)
        together = np.flatnonzero(away < TOUCH)
        if SHARED <= len(together) < min(one.seen.sum(), other.seen.sum()):
            middle = int(np.median(together))
            joined += [_joined(one, other, middle), _joined(other, one, middle)]
    return joined


def continued(bodies: list[Hypothesis], times: Float[np.ndarray, " t"]) -> list[Hypothesis]:
    """Each that is lost and soon goes on as another that looks like it, with all that follows.

    Args:
        bodies: what was followed.
        times: of each frame, in units of the usual interval.
    """
    joined = []
    for body in bodies:
        whole = body
        while (rest := _going_on(whole, bodies, times)) is not None:
            whole = _joined(whole, rest, _first(rest))
        if whole is not body:
            joined.append(whole)
    return joined


def _going_on(body: Hypothesis, bodies: list[Hypothesis], times: np.ndarray) -> Hypothesis | None:
    """What begins first of all that look like it, where it may be, soon after it was lost."""
    seen = np.flatnonzero(body.seen)
    looks = _looks(body, seen[-LOOKED_AT:])
    if looks is None:
        return None
    before, last = seen[-2:]
    speed = (body.positions[last] - body.positions[before]) / (times[last] - times[before])

    def goes_on(other: Hypothesis) -> bool:
        first = _first(other)
        likes = _looks(other, np.flatnonzero(other.seen)[:LOOKED_AT])
        if first <= last or likes is None:
            return False
        away = times[first] - times[last]
        off = np.linalg.norm(other.positions[first] - body.positions[last] - away * speed)
        reach = LEAST_REACH + REACH * body.usual_size + away * np.linalg.norm(speed)
        return bool(away <= LOST and off < reach and np.linalg.norm(looks - likes) < ALIKE)

    return min((each for each in bodies if goes_on(each)), key=_first, default=None)


def _first(body: Hypothesis) -> int:
    """The first frame in which it was seen."""
    return int(body.seen.argmax())


def _meetings(one: Hypothesis, other: Hypothesis) -> list[tuple[int, int]]:
    """First and last frame of each time in which they are near."""
    both = np.nonzero(one.seen & other.seen)[0]
    if not len(both):
        return []
    away = np.linalg.norm(one.positions - other.positions, axis=-1)[both]
    frames = np.arange(len(one.seen))
    reach = MET * (one.usual_size + other.usual_size)
    near = np.flatnonzero(np.interp(frames, both, away) < reach)
    if not len(near):
        return []
    runs = np.split(near, np.flatnonzero(np.diff(near) > 1) + 1)
    return [(int(run[0]), int(run[-1])) for run in runs]


def _exchanged(one: Hypothesis, other: Hypothesis, first: int, last: int) -> bool:
    before, after = slice(max(0, first - LOOKED_AT), first), slice(last + 1, last + 1 + LOOKED_AT)
    a, b = _looks(one, before), _looks(other, before)
    c, d = _looks(one, after), _looks(other, after)
    if a is None or b is None or c is None or d is None:
        return False
    kept = np.linalg.norm(a - c) + np.linalg.norm(b - d)
    crossed = np.linalg.norm(a - d) + np.linalg.norm(b - c)
    return bool(crossed < kept - SURE)


def _looks(body: Hypothesis, part: slice | np.ndarray) -> Float[np.ndarray, " looks"] | None:
    """Colour and size, in units of what one body may differ from itself."""
    size, colour = body.size[part], body.colour[part]
    shown = np.isfinite(size)
    if shown.sum() < FEWEST:
        return None
    shade = np.median(colour[shown], 0) / RECOLOURED
    return np.append(shade, 2 * np.median(np.log(size[shown])) / GROWN)


def _joined(before: Hypothesis, after: Hypothesis, frame: int) -> Hypothesis:
    """The first until a frame, the second from it on."""
    parts = {
        f.name: np.concatenate([getattr(before, f.name)[:frame], getattr(after, f.name)[frame:]])
        for f in fields(before)
        if f.name != "cornered"
    }
    return replace(before, **parts, cornered=before.cornered and after.cornered)
