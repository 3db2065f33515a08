"""Corners of the picture that are carried along, and groups of them that move as one.

A body that goes less far than it is wide never shows what is behind it, and before other things
that move nothing stands still behind it: then no background tells where it is, but its corners do.
They are followed from frame to frame by Lucas and Kanade (1981) in a pyramid, forwards and back.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from binders.base import Pictures
from binders.reel import Through

LOOKS = 5  # frames, spread over the clip, whose corners are followed
CORNERS = 300  # of a frame
QUALITY = 0.01  # of the best corner's
APART = 3  # pixels between corners
WINDOW = (9, 9)
LEVELS = 3
PRECISE = (3, 20, 0.01)  # steps, and pixels
RETURNED = 0.7  # pixels, within which a corner that is followed forwards and back is where it was
ANCHORED = 1.0  # pixels, within which the look that it first had is taken to be where it is
BORDER = 2  # pixels of the picture's edge where none is followed
STIRRED = 5  # pixels around what changes, where corners are looked for
MOVED = 0.6  # pixels, root mean square, from which a corner moves
TOGETHER = 0.6  # pixels, root mean square, up to which two move as one
OVERLAP = 0.25  # of the frames, in which both are seen
NEAR = 0.3  # of the picture's shorter side, within which they are of one body
FEWEST = 3  # corners of a group
GROUPS = 24
LEAPS = 3.0, 2.0  # times its way in the frames beside, and pixels, that a corner may go in one
TELLING = 4000  # frames that tell which move as one


@dataclass(frozen=True)
class Group:
    """Corners that move as one.

    Args:
        positions: of their middle, ``(t, 2)`` pixels; NaN where none is seen.
        spread: of them about it, pixels, root mean square.
        corners: how many they are.
    """

    positions: Float[np.ndarray, "t 2"]
    spread: float
    corners: int


def carried(frames: Pictures, stirred: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "t n 2"]:
    """Corners that are followed through the clip and move, pixels; NaN where one is lost.

    Args:
        frames: before a still camera.
        stirred: where anything changes in the course of the clip.
    """
    import cv2

    grey = Through(frames, grey_of)
    around = np.ones((2 * STIRRED + 1, 2 * STIRRED + 1), np.uint8)
    where = 255 * cv2.dilate(stirred.astype(np.uint8), around)
    found = [np.empty((len(frames), 0, 2), np.float32)]
    for look in np.unique(np.linspace(0, len(frames) - 1, 2 * LOOKS + 1).astype(int)[1::2]):
        corners = cv2.goodFeaturesToTrack(grey[look], CORNERS, QUALITY, APART, mask=where)
        if corners is not None:
            found.append(_moving(followed(grey, int(look), corners[:, 0])))
    return np.concatenate(found, 1)


def grey_of(frame: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Its brightness."""
    import cv2

    grey: np.ndarray = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY)
    return grey


def _moving(paths: np.ndarray) -> np.ndarray:
    """Those of corners ``(t, n, 2)`` that are seen for long and move."""
    paths = paths[:, np.isfinite(paths[..., 0]).sum(0) > OVERLAP * len(paths)]
    off, _ = _off(paths.astype(float))
    count = np.isfinite(paths[..., 0]).sum(0)
    moving: np.ndarray = paths[:, (off**2).sum((0, 2)) / count > MOVED**2]
    return moving


def _off(paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of corners ``(t, n, 2)`` how far each is off its middle, 0 where unseen; and these."""
    seen = np.isfinite(paths[..., :1])
    middle = np.where(seen, paths, 0).sum(0) / np.maximum(seen.sum(0), 1)
    return np.where(seen, paths - middle, 0), middle


def followed(
    grey: Sequence[np.ndarray] | Through, look: int, corners: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "t n 2"]:
    """Corners of one frame in all of them, pixels; NaN from where one is lost on."""
    paths = np.full((len(grey), len(corners), 2), np.nan, np.float32)
    paths[look] = corners
    for order in (range(look, len(grey)), range(look, -1, -1)):
        _follow(grey, order, paths)
    return paths


def _follow(grey: Sequence[np.ndarray] | Through, order: range, paths: np.ndarray) -> None:
    """Fill in the paths from the first frame of an order on."""
    import cv2

    lucas_kanade: Any = cv2.calcOpticalFlowPyrLK
    settings: Any = {"winSize": WINDOW, "criteria": PRECISE}
    guessed: Any = {**settings, "flags": cv2.OPTFLOW_USE_INITIAL_FLOW, "maxLevel": 0}
    high, wide = grey[0].shape
    first = paths[order.start]
    live, here = np.arange(len(first)), first.copy()
    for before, frame in zip(order[:-1], order[1:], strict=True):
        if not len(live):
            return
        there, found, _ = lucas_kanade(
            grey[before], grey[frame], here, None, maxLevel=LEVELS, **settings
        )
        back, again, _ = lucas_kanade(grey[frame], grey[before], there, here.copy(), **guessed)
        anchor, known, _ = lucas_kanade(
            grey[order.start], grey[frame], first[live], there.copy(), **guessed
        )
        kept = (found[:, 0] > 0) & (again[:, 0] > 0)
        kept &= np.linalg.norm(back - here, axis=-1) < RETURNED
        sure = (known[:, 0] > 0) & (np.linalg.norm(anchor - there, axis=-1) < ANCHORED)
        there = np.where(sure[:, None], anchor, there)
        kept &= ((there > BORDER) & (there < np.array([wide, high]) - 1 - BORDER)).all(-1)
        live, here = live[kept], there[kept]
        paths[frame, live] = here


def groups(paths: Float[np.ndarray, "t n 2"], side: float) -> Iterator[Group]:
    """Corners that move as one, those of which most do first.

    Of a long clip not every frame tells which do.

    Args:
        paths: see :func:`carried`.
        side: of the picture, the shorter one, pixels.
    """
    some = paths[:: -(-len(paths) // TELLING)].astype(float)
    off, middle = _off(some)
    left = np.ones(len(middle), bool)
    alike = _as_one(off, np.isfinite(some[..., 0]), middle, side)
    for _ in range(GROUPS):
        company = np.where(left, (alike & left).sum(1), 0)
        if not len(company) or company.max() < FEWEST:
            return
        leader = int(company.argmax())
        members = np.flatnonzero(alike[leader] & left)
        left[members] = False
        yield _middle(paths[:, members].astype(float), int(np.searchsorted(members, leader)))


def _as_one(off: np.ndarray, seen: np.ndarray, middle: np.ndarray, side: float) -> np.ndarray:
    """Which corners keep their distance from which, ``(n, n)`` boolean."""
    mask = seen.astype(float)
    both = mask.T @ mask
    shared = np.maximum(both, 1)
    apart, spread = np.zeros((2, *both.shape)), np.zeros(both.shape)
    for axis in (0, 1):
        x = off[..., axis]
        mean = (x.T @ mask - mask.T @ x) / shared
        square = (x * x).T @ mask + mask.T @ (x * x) - 2 * x.T @ x
        spread += square / shared - mean**2
        apart[axis] = middle[:, None, axis] - middle[:, axis] + mean
    near = np.hypot(*apart) < NEAR * side
    return near & (both >= OVERLAP * len(off)) & (spread < TOGETHER**2)


def _middle(paths: np.ndarray, leader: int) -> Group:
    """Of corners that keep their distances; the leader is seen beside each of them."""
    offset = np.nanmedian(paths - paths[:, [leader]], 0)
    places = paths - offset
    shown = np.isfinite(places[..., 0]).any(1)
    positions = np.full((len(paths), 2), np.nan)
    positions[shown] = np.nanmedian(places[shown], 1)
    positions[~_longest_way(positions)] = np.nan
    from_middle = offset - offset.mean(0)
    spread = float(np.sqrt((from_middle**2).sum(-1).mean()))
    return Group(positions + offset.mean(0), spread, len(offset))


def _longest_way(places: np.ndarray) -> np.ndarray:
    """Where places ``(t, 2)`` go on without a leap for longest.

    Corners of a body that comes to an edge behind it may stay with the edge.
    """
    seen = np.flatnonzero(np.isfinite(places[:, 0]))
    steps = np.pad(np.linalg.norm(np.diff(places[seen], axis=0), axis=-1), 1)
    usual = np.maximum(steps[:-2], steps[2:])
    leaps = np.flatnonzero(steps[1:-1] > LEAPS[0] * usual + LEAPS[1]) + 1
    parts = np.split(seen, leaps)
    way = np.zeros(len(places), bool)
    way[max(parts, key=len)] = True
    return way
