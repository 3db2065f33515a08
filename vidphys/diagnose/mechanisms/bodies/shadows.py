"""What goes with a body all the time: its shadow, a reflection, or a part of it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.statistics import noise_of

# of its way: what two bodies leave of the proportion at least that move by themselves; a lens bends
# that of a shadow by up to 0.031, as was seen in a filmed clip
APART = 0.04
WHOLE, EXACT = 0.8, 0.03  # of the frames, in which nothing hides a part of a shadow; left in these
ALIKE = 0.03  # of a body's way, by which one that is made alike and let go alike may differ
AS_FAR = 0.7  # of a shadow's way, that the way of what casts it has: a piece of a string goes less
UPRIGHT = 0.05  # of its height above a body, by which a piece of what that hangs by is to its side
ROUGHER = 1.2  # times a body's, that the noise of such a piece is at least: little of it shows
SWINGS = 3  # times at least that it passes its middle: what does not come back tells nothing
CURVED = 0.1  # of the length of a way, that it is wide which is no line
RESIZED = 0.1  # that a shadow is smaller or larger by, at least, than what flies alike
SELDOMER = 0.02  # of the frames, by which a part is seen less often than the body
PART = "goes with {} wherever it goes, as a part of it does"
SHADOW = "moves in proportion to {}, as its shadow, reflection or a piece of it does"
SMOOTH = 0.1  # of what bends a flight, that is left of it beside a constant acceleration, at most
DOWN = 0.9  # of its acceleration, that is down, at least
FALLS_ELSE = 0.4  # of its acceleration, by which that of what does not fall with it differs: two
# that are thrown fall alike, or the farther one seems to by the ratio of their distances
TOGETHER = 0.9  # of the frames in which the less seen one is seen, so that both are


def without_shadows(motion: Motion) -> tuple[list[int], tuple[str, ...]]:
    """Bodies that are not another's shadow or part, of several followed things.

    Along the way that it swings most, a shadow is where its body is, times a factor, or where a
    perspective picture of its plane puts it. Two bodies do that only if they are let go together
    and are alike, and then their ways are each other's copy. Light comes from above, so of two such
    things the upper one is the body, unless it is a piece of the string or spring by which the
    lower one hangs; and a floor mirrors up and down, so what goes right whenever
    the other goes left is neither. Copies that are nearer to each other than they go are parts of
    one body, as a cart's wheels are; the one that is seen less often is the part, or is the less
    likely one.

    Args:
        motion: of one clip; the likeliest bodies come first.

    Returns:
        The bodies, and what a person should know of those that are none.
    """
    cast: dict[int, str] = {}
    for body, other in combinations(range(motion.bodies), 2):
        if body in cast or other in cast:
            continue
        how = goes_with(motion, body, other)
        if how:
            less = _seen_less if how == PART else _below
            of, thing = (other, body) if less(motion, body, other) else (body, other)
            cast[thing] = f"thing {thing + 1} {how.format(f'thing {of + 1}')}: it is left out"
    return [body for body in range(motion.bodies) if body not in cast], tuple(cast.values())


def goes_with(motion: Motion, body: int, other: int) -> str:
    """How one goes with another, in words; empty where it goes its own way."""
    places = motion.positions[0][:, [body, other]]
    seen = np.isfinite(places).all(-1)
    both = seen.all(-1)
    if both.sum() < max(LEAST_FRAMES, TOGETHER * seen.sum(0).min()):
        return ""
    middle = places[both].mean(0)
    here = places[both] - middle
    main = [np.linalg.svd(here[:, i], full_matrices=False)[2][0] for i in range(2)]
    one, two = (here[:, i] @ main[i] for i in range(2))
    if np.count_nonzero(np.diff(np.sign(one))) < SWINGS:
        above, below = np.argsort(-middle[:, 1])
        apart = (places[both][:, above, 1] > places[both][:, below, 1]).all()
        cast = apart and _casts_in_flight(np.flatnonzero(both), here[:, above], here[:, below])
        return SHADOW if cast or _flies_with(here) else ""
    copied = np.linalg.norm(here[:, 1] - here[:, 0]) / np.linalg.norm(here[:, 0])
    if copied <= ALIKE:
        near = np.linalg.norm(middle[1] - middle[0]) < np.ptp(one)
        return PART if near else ""
    against = main[0] * main[1] * (one @ two) < 0  # right against left, up against down
    if against[np.abs(main[0]).argmax()] and abs(main[0][1]) < abs(main[0][0]):
        return ""
    straight = np.linalg.norm(two - one * (one @ two) / (one @ one)) / np.linalg.norm(two)
    cast = straight < APART or _left_of_projection(here, main[1]) < APART
    return SHADOW if cast or _left_where_whole(one, two) < EXACT else ""


def _left_where_whole(one: np.ndarray, two: np.ndarray) -> float:
    """What the proportion leaves of the other's way, ``(t,)`` each, without the worst frames.

    A foot or a leg that hides a part of a shadow draws it aside each time that it passes there.
    """
    whole = np.arange(len(one))
    for _ in range(2):
        factor, there = np.polyfit(one[whole], two[whole], 1)
        left = two - factor * one - there
        whole = np.argsort(np.abs(left))[: int(WHOLE * len(left))]
    return float(np.sqrt(np.mean(left[whole] ** 2)) / np.std(two))


def _flies_with(here: np.ndarray) -> bool:
    """Whether a way is another of one flight up and down, in another size.

    All that is let go at once falls alike. But what is thrown sideways as well goes as far to the
    side, for its fall, only if it is thrown alike; its way is then as large, unless it is farther
    away.

    Args:
        here: places of both about their middles, ``(t, 2, 2)``.
    """
    one, two = here[:, 0], here[:, 1]
    factor = float((one * two).sum() / (one**2).sum())
    across, along = np.linalg.svd(one, compute_uv=False)[::-1]
    turns = np.count_nonzero(np.diff(np.sign(one[:, 1]))) == SWINGS - 1
    left = np.linalg.norm(two - factor * one) / np.linalg.norm(two)
    return bool(turns and across > CURVED * along and abs(factor - 1) > RESIZED and left < APART)


def _casts_in_flight(frames: np.ndarray, one: np.ndarray, two: np.ndarray) -> bool:
    """Whether what keeps below a thing that is thrown is its shadow on a floor.

    It is where the plane of the flight is seen on the floor, and does not fall as a second thing
    does that is thrown.

    Args:
        frames: in which both are seen, ``(t,)``.
        one, two: places of both about their middles, ``(t, 2)``.
    """
    since = frames - frames.mean()
    powers = np.stack([np.ones_like(since), since, since**2], 1)
    (_, _, pull), (_, _, other) = (np.linalg.lstsq(powers, x, rcond=None)[0] for x in (one, two))
    bent = one - powers[:, :2] @ np.linalg.lstsq(powers[:, :2], one, rcond=None)[0]
    rest = one - powers @ np.linalg.lstsq(powers, one, rcond=None)[0]
    across, along = np.linalg.svd(one, compute_uv=False)[::-1]
    flies = (
        np.linalg.norm(rest) < SMOOTH * np.linalg.norm(bent)
        and -pull[1] > DOWN * np.linalg.norm(pull)
        and across > CURVED * along
    )
    if not flies or np.linalg.norm(other - pull) < FALLS_ELSE * np.linalg.norm(pull):
        return False
    main = np.linalg.svd(two, full_matrices=False)[2][0]
    return _left_of_projection(np.stack([one, two], 1), main) < APART


def _left_of_projection(here: np.ndarray, main: np.ndarray) -> float:
    """What is left of the other's way when it is the picture of a shadow on a plane.

    A body that keeps to a plane and its shadow on another plane are each other's picture by a
    homography: a shadow that comes nearer to the camera swings wider.

    Args:
        here: places of both about their middles, ``(t, 2, 2)``.
        main: along which the other swings most, ``(2,)``.
    """
    import cv2

    seen_as, _ = cv2.findHomography(here[:, 0].copy(), here[:, 1].copy())
    if seen_as is None:  # no picture of a plane comes from a line
        return np.inf
    projected = cv2.perspectiveTransform(here[None, :, 0], seen_as)[0]
    way = here[:, 1] @ main
    return float(np.linalg.norm(way - projected @ main) / np.linalg.norm(way))


def _seen_less(motion: Motion, body: int, other: int) -> bool:
    """Whether one is seen less often than another."""
    one, two = motion.seen[0][:, [body, other]].mean(0)
    return bool(two - one >= SELDOMER)


def _below(motion: Motion, body: int, other: int) -> bool:
    """Whether one keeps below another that goes nearly as far, and does not hang by it."""
    places = motion.positions[0][:, [body, other]]
    places = places[np.isfinite(places).all((1, 2))]
    one, two = (np.linalg.norm(places[:, i].std(0)) for i in range(2))
    if not (places[:, 0, 1] < places[:, 1, 1]).all() or two <= AS_FAR * one:
        return False
    aside, above = places[:, 1].mean(0) - places[:, 0].mean(0)
    rougher = noise_of(places[:, 1]) > ROUGHER * noise_of(places[:, 0])
    return not (two < one and abs(aside) < UPRIGHT * above and rougher)
