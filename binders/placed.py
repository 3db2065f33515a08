"""Where a body is, told by its whole outline or picture and not by what of it stands out.

Part of a body may look as what is behind it does, or something may be at it: then the middle of
what stands out is not the body's. What most frames agree on is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from binders.base import Pictures
from binders.hypotheses import Hypothesis
from binders.lawful import PIXEL, foretold, steadiness
from binders.turned import turns

ROUNDS = 3
AROUND = 1.6  # of the body's mean radius, that is looked at
REACH = 1.5, 0.7, 0.5  # radii, within which it is looked for in each round
MODEL = 60  # frames that tell its looks
AGREED = 0.5  # of the frames, in which a pixel is the body's
RIM = 2  # pixels around it that are not
SOFT = 0.7  # pixels, by which an outline is smoothed
STEADY = 0.6  # :func:`.lawful.steadiness`, below which it has not one picture
BETTER = 0.08  # of the logarithm of how far off a law is, to leave an earlier way for a later one
MUCH_BETTER = 0.15  # to leave what is mended for what is not: that may err smoothly, as a law does
WHOLE = 0.94  # of its usual size, below which a blob is but a part of it
AS_USUAL = 1.2  # times the usual difference from its picture, that is found there
TOGETHER = 0.1  # sizes, within which three ways are at one place
OFF = 4.0  # times as far as usual from what two of three agree on, and a place's error: it is wrong
OUTVOTED = 0.3  # of how far the blobs are from each of two other ways: those that are nearer agree
LEAVES = 0.9  # sizes, by which corners leave the body
USUALLY = 95  # per cent of the frames that count for that
LEAST = 5.0  # pixels, by which they do at least: the outline of what is small is rough
AS_LAWFUL = 0.6  # times as well as theirs its outline's way is foretold then, or something hides it


@dataclass(frozen=True)
class _Looks:
    """Patches of equal size, ``(side, side, c)``, and which of their pixels count."""

    patch: np.ndarray
    counts: np.ndarray


def placed(
    body: Hypothesis,
    frames: Pictures,
    changed: Pictures,
    times: Float[np.ndarray, " t"],
) -> Hypothesis:
    """The hypothesis at the places, of three ways to tell them, that are the most lawful.

    They are the middles of its outline, those of its blobs, and, unless it changes its looks as
    what turns or is seen from ever another side does, those of its picture. In frames where one
    is off from what two of the three agree on, as where something passes, it is there. Where
    outline and picture agree against the blobs throughout, these do not count: what stands out of
    a body only before a white board moves along the board, which is a law as well. Nor do corners
    that leave its outline: those of its edge with the board's do the same; nor those of what turns,
    which go round with its mark.

    Args:
        body: as blobs show it, pixels of the frames.
        frames: before a still camera, evenly lit.
        changed: what differs from the background in each.
        times: of each frame, in units of the usual interval.
    """
    outline, _ = _refined(body, frames, changed, pictured=False)
    ways, best, told = [outline, body.positions], outline, -np.inf
    left = body.cornered and _strays(body.positions, outline, times, body.usual_size)
    if steadiness(body) > STEADY:
        if _turns(body, frames, _middles(body, outline, changed)):
            left = left or body.cornered
        else:
            picture, unlike = _refined(body, frames, changed, pictured=True)
            ways.append(picture)
            mended = _mended(body, ways, unlike)
            left = left or _agree(outline, picture, body.positions)
            best, told = _most_lawful(mended[:1] + mended[1 + left :], times)
    other, as_told = _most_lawful(ways[:1] + ways[1 + left :], times)
    return replace(body, positions=other if as_told > told + MUCH_BETTER else best)


def _strays(places: np.ndarray, outline: np.ndarray, times: np.ndarray, size: float) -> bool:
    """Whether places leave what an outline shows, that goes about as lawfully."""
    off = places - outline
    far = np.nanpercentile(_length(off - np.nanmedian(off, 0)), USUALLY)
    lawful = foretold(outline, times) > AS_LAWFUL * foretold(places, times)
    return bool(far > max(LEAVES * size, LEAST) and lawful)


def _most_lawful(ways: list[np.ndarray], times: np.ndarray) -> tuple[np.ndarray, float]:
    """The way that a law foretells best, an earlier one if nearly as well; and how well."""
    best, told = ways[0], foretold(ways[0], times)
    for places in ways[1:]:
        as_told = foretold(places, times)
        if as_told > told + BETTER:
            best, told = places, as_told
    return best, told


def _mended(body: Hypothesis, three: list[np.ndarray], unlike: np.ndarray) -> list[np.ndarray]:
    """Three ways, the last its picture, each where two of them agree if it is far off from there.

    Where its blob is but a part of it, two may agree on the middle of that part. There it is where
    its picture is, if that is as like it as usual; else it is seen only if all three agree.
    """
    ways = np.stack(three)
    part = body.size < WHOLE * body.usual_size
    whole = body.seen & ~part
    if not whole.any():
        return list(three)
    shift = np.median((ways - ways[:1])[:, whole], 1)[:, None]  # they tell points of their own
    ways = ways - shift
    voted = np.median(ways, 0)
    voted[part & (_length(np.ptp(ways, 0)) > TOGETHER * body.usual_size)] = np.nan
    found = part & (unlike < AS_USUAL * np.nanmedian(unlike))
    voted[found] = ways[-1, found]
    off = _length(ways - voted)
    wrong = part | (off > OFF * np.median(off[:, whole], 1)[:, None] + PIXEL)
    return list(np.where(wrong[..., None], voted, ways) + shift)


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _agree(one: np.ndarray, other: np.ndarray, third: np.ndarray) -> bool:
    """Whether two ways tell one motion, from which a third is far off."""
    return _apart(one, other) < OUTVOTED * min(_apart(one, third), _apart(other, third))


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square distance of places ``(t, 2)``, but for a usual one: of another point."""
    off = one - other
    return float(np.sqrt(np.nanmean((off - np.nanmedian(off, 0)) ** 2)))


def _some(body: Hypothesis) -> list[int]:
    """Frames that tell its looks, of those in which it is seen."""
    seen = np.nonzero(body.seen)[0].tolist()
    return seen[:: max(1, len(seen) // MODEL)]


def _middles(body: Hypothesis, places: np.ndarray, changed: Pictures) -> np.ndarray:
    """Places that keep to a point of a body, moved to the usual middle of what stands out there."""
    half, off = int(np.ceil(AROUND * body.usual_size)), []
    for k in _some(body):
        corner = np.rint(places[k]).astype(int) - half
        y, x = np.nonzero(_window(changed[k], corner, 2 * half + 1))
        if len(x):
            off.append(np.array([x.mean(), y.mean()]) + corner - places[k])
    return places + np.median(off, 0) if off else places


def _turns(body: Hypothesis, frames: Pictures, places: np.ndarray) -> bool:
    import cv2

    half = int(np.ceil(body.usual_size))
    square = (2 * half + 1, 2 * half + 1)
    patches = [
        cv2.getRectSubPix(frames[k].astype(np.float32), square, places[k].tolist())
        for k in _some(body)
    ]
    return turns(np.stack(patches), body.usual_size)


def _refined(
    body: Hypothesis, frames: Pictures, changed: Pictures, pictured: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Its places by its picture, or by its outline.

    And how unlike it is there, ``(t,)``.
    """
    import cv2

    size, seen = body.usual_size, np.nonzero(body.seen)[0]
    half = max(3, int(np.ceil(AROUND * size)))
    far = half + int(np.ceil(REACH[0] * size)) + 1
    corners = np.rint(body.positions[seen]).astype(int) - far

    def outline(n: int) -> np.ndarray:
        cut = _window(changed[seen[n]].astype(np.float32), corners[n], 2 * far + 1)
        return cv2.GaussianBlur(cut, (0, 0), SOFT)

    def picture(n: int) -> np.ndarray:
        return _window(frames[seen[n]], corners[n], 2 * far + 1).astype(np.float32)

    shown = picture if pictured else outline
    within = body.positions[seen] - corners
    for reach in REACH:
        looks = _looks(shown, outline, within, half, pictured)
        found = [_found(shown(n), looks, place, reach * size) for n, place in enumerate(within)]
        within = np.array([place for place, _ in found])
    places, unlike = body.positions.copy(), np.full(len(body.seen), np.nan)
    places[seen] = within + corners
    unlike[seen] = [each for _, each in found]
    return places, unlike


def _window(image: np.ndarray, corner: np.ndarray, side: int) -> np.ndarray:
    """A square, its upper left pixel at ``corner``; beyond the edge it is the edge's."""
    size = image.shape[1::-1]
    x, y = (np.clip(c + np.arange(side), 0, n - 1) for c, n in zip(corner, size, strict=True))
    return image[np.ix_(y, x)]


def _looks(
    shown: Callable[[int], np.ndarray],
    outline_of: Callable[[int], np.ndarray],
    places: np.ndarray,
    half: int,
    pictured: bool,
) -> _Looks:
    """What most frames agree on, about the places."""
    import cv2

    some = range(0, len(places), max(1, len(places) // MODEL))
    square = (2 * half + 1, 2 * half + 1)

    def cut(image: np.ndarray, place: np.ndarray) -> np.ndarray:
        patch = cv2.getRectSubPix(image, square, place.astype(np.float32).tolist())
        return patch.reshape(*square, -1)

    outline = np.mean([cut(outline_of(n), places[n]) for n in some], 0)
    inside = (outline > AGREED).astype(np.uint8)[..., 0]
    if pictured:
        patch = np.median([cut(shown(n), places[n]) for n in some], 0)
        return _Looks(patch.astype(np.float32), inside.astype(np.float32))
    rim = cv2.dilate(inside, np.ones((2 * RIM + 1, 2 * RIM + 1), np.uint8))
    return _Looks(outline.astype(np.float32), rim.astype(np.float32))


def _found(
    window: np.ndarray, looks: _Looks, place: np.ndarray, reach: float
) -> tuple[np.ndarray, float]:
    """Where in a window it fits best, near a place; and how far off its looks are there.

    The place, and infinity, where it is nowhere.
    """
    import cv2

    if not looks.counts.any():
        return place, np.inf
    half, n = len(looks.patch) // 2, int(np.ceil(reach))
    middle = np.rint(place).astype(int)
    low = np.maximum(middle - n - half, 0)
    high = np.minimum(middle + n + half + 1, window.shape[0])
    if (high - low < 2 * half + 3).any():
        return place, np.inf
    part = np.ascontiguousarray(window[low[1] : high[1], low[0] : high[0]])
    mask = np.repeat(looks.counts[..., None], looks.patch.shape[2], 2)
    cost = cv2.matchTemplate(part, looks.patch, cv2.TM_SQDIFF, mask=mask)
    y, x = (int(i) for i in np.unravel_index(int(cost.argmin()), cost.shape))
    unlike = float(np.sqrt(max(cost[y, x], 0) / looks.counts.sum()))
    return low + half + np.array([vertex(cost[y], x), vertex(cost[:, x], y)]), unlike


def vertex(values: Float[np.ndarray, " k"], best: int) -> float:
    """The least of a parabola through the smallest value, at ``best``, and its neighbours."""
    if not 0 < best < len(values) - 1:
        return float(best)
    before, here, after = values[best - 1 : best + 2].astype(float)
    bend = before - 2 * here + after
    return best + (0.5 * (before - after) / bend if bend > 0 else 0.0)
