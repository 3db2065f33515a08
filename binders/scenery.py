"""What stands still in a clip, how much a frame differs from it, and where it does so in lumps."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Shaped

from binders.blobs import Blobs

CANDIDATES = 16
NOISE_SIGMAS = 6.0
LEAST_CHANGE = 10.0
MISALIGNED = 0.5  # pixels
PIXEL = 1 / 12  # variance of a place within one
COLOURED = 3.0  # a third of a body that changes in more than brightness is enough
GHOST = 0.7  # of how the background stands out there, that a body does at least
EDGE = 0.01  # of the picture's shorter side: as near as that, the edge cuts a region
AROUND = 7  # pixels of a square, within which what is next to a region lies
ARM = 0.5  # of the half width of a region, that its arms are narrower than
STOUT = 0.85  # of its area, that is left of a region without arms when they are cut
NOTICED = 20.0  # distance in Lab between colours that nobody takes for one another


class Scenery:
    """What stands still, and how much an image differs from it.

    Args:
        background: RGB, 0 to 255.
        shadow: a pixel whose colour is the background's times a factor between this and its
            inverse counts as lit differently; 1 keeps every change.
    """

    def __init__(self, background: Float[np.ndarray, "h w 3"], shadow: float) -> None:
        self.background, self.shadow = background.astype(np.float32), shadow
        self.power = np.maximum(_dot(self.background, self.background), 1.0)
        down, right = (np.asarray(g) for g in np.gradient(self.background, axis=(0, 1)))
        self.slack = MISALIGNED * np.sqrt(_dot(down, down) + _dot(right, right))

    def change(self, image: Shaped[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
        """Distance in RGB from the background under the light that explains the pixel best.

        Less what a small misalignment makes of an edge of the background.
        """
        image = image.astype(np.float32)
        if self.shadow == 1:
            rest = image - self.background
        else:
            light = _dot(image, self.background) / self.power
            light = np.clip(light, self.shadow, 1 / self.shadow)
            rest = image - light[..., None] * self.background
        return np.maximum(np.sqrt(_dot(rest, rest)) - self.slack, 0)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    import cv2

    return cv2.transform(a * b, np.ones((1, 3), np.float32))


def threshold_of(change: Float[np.ndarray, "t h w"]) -> float:
    """The change that noise does not make."""
    middle = float(np.median(change))
    spread = 1.4826 * float(np.median(np.abs(change - middle)))
    return max(LEAST_CHANGE, middle + NOISE_SIGMAS * spread)


def lumps(
    image: Shaped[np.ndarray, "h w 3"],
    change: Float[np.ndarray, "h w"],
    threshold: float,
    thin: int,
    coloured: Bool[np.ndarray, "h w"],
    behind: Shaped[np.ndarray, "h w 3"] | None,
) -> tuple[Blobs, Bool[np.ndarray, "h w"]]:
    """The regions of a frame that changed most, and where ghosts are.

    One that the picture's edge cuts is left out: the middle of what is seen of it is not its own,
    and it may be the hand or the person that set things going. So is one whose outline is not in
    the picture but in the background: a ghost, where something stood that is gone.

    Args:
        image: RGB.
        change: of each pixel, as :meth:`Scenery.change`.
        threshold: above which it is no noise.
        thin: structures thinner than this many pixels belong to no body.
        coloured: pixels that changed in more than brightness.
        behind: the background; ``None`` where no ghosts are looked for.
    """
    import cv2

    above, square = (change > threshold).astype(np.uint8), np.ones((thin, thin), np.uint8)
    core = cv2.morphologyEx(above, cv2.MORPH_OPEN, square)
    count, labels = cv2.connectedComponents(core, connectivity=4)
    keep = np.ones(count, bool)
    edge = max(1, round(EDGE * min(labels.shape)))
    for cut in (labels[:edge], labels[-edge:], labels[:, :edge], labels[:, -edge:]):
        keep[cut] = False
    keep[0] = False
    where = _around(core)
    left, top = where[1].start, where[0].start
    haunted = np.zeros(core.shape, bool)  # of the whole picture; the rest is of that part
    image, change, coloured = image[where], change[where], coloured[where]
    above, core, labels = above[where], core[where], labels[where]
    labels, whole = _without_arms(core, labels, count)
    count = len(whole)
    keep = keep[whole] & (np.bincount(labels.ravel(), minlength=count) > 0)
    if behind is not None:
        ghosts = keep & _ghosts(labels, count, above, image, behind[where])
        keep &= ~ghosts
        haunted[where] = ghosts[labels]
    number = np.cumsum(keep) - 1
    y, x = np.nonzero(keep[labels])
    # the weight saturates, so that texture and highlights inside a body do not move its centroid
    weight = np.clip((change[y, x] - threshold) / threshold, 0.01, 1.0)
    totals = _Totals(number[labels[y, x]], int(keep.sum()), weight)
    found = _measured(totals, x + left, y + top, change[y, x], image[y, x], coloured[y, x])
    return found.only(np.argsort(np.argsort(-found.energy)) < CANDIDATES), haunted


def _around(core: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of all regions and of what is next to them: often few of a picture's."""
    import cv2

    left, top, width, height = cv2.boundingRect(core)
    # From an even one on, because OpenCV numbers regions by blocks of two.
    left, top = (max(x - AROUND, 0) // 2 * 2 for x in (left, top))
    return np.s_[top : top + height + 3 * AROUND, left : left + width + 3 * AROUND]


def _without_arms(
    core: np.ndarray, labels: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Regions opened by a disc of half their own width, where that takes much off them.

    Returns:
        Their labels, and for each the region that it was of.
    """
    import cv2

    ground = cv2.copyMakeBorder(core, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    deep = cv2.distanceTransform(ground, cv2.DIST_L2, 5)[1:-1, 1:-1]
    inside = np.nonzero(labels)  # few of a picture's pixels
    region, half = labels[inside], np.zeros(count, np.float32)
    np.maximum.at(half, region, deep[inside])
    arm, inner = ARM * half[region], np.zeros_like(core)
    inner[inside] = deep[inside] > arm
    parts, numbers = cv2.connectedComponents(inner, connectivity=8)
    if parts == 1:
        return labels, np.arange(count)
    away, nearest = (x[inside] for x in cv2.distanceTransformWithLabels(1 - inner, cv2.DIST_L2, 5))
    seeds, whole = numbers[inside], np.zeros(parts, int)
    of_seed = np.zeros(nearest.max() + 1, int)
    of_seed[nearest[seeds > 0]] = seeds[seeds > 0]
    whole[seeds] = region
    whole[0] = 0
    part = of_seed[nearest]
    part = np.where((whole[part] == region) & (away <= arm), part, 0)
    before = np.bincount(region, minlength=count)
    after = np.bincount(region[part > 0], minlength=count)
    stout = after > STOUT * before
    alone = np.zeros(count, int)
    alone[whole] = np.arange(parts)
    cut_off = np.zeros(labels.shape, int)
    cut_off[inside] = np.where(stout[region], alone[region], part)
    return cut_off, whole


def _ghosts(
    labels: np.ndarray, count: int, above: np.ndarray, image: np.ndarray, background: np.ndarray
) -> np.ndarray:
    """Which regions stand out from what is around them in the background, not in the picture."""
    import cv2

    around = cv2.dilate(labels.astype(np.uint16), np.ones((AROUND, AROUND), np.uint8))
    inside, beside = np.nonzero(labels), np.nonzero(around * (above == 0))
    pixels = [(label[where], where) for label, where in ((labels, inside), (around, beside))]
    counts = [np.bincount(label, minlength=count) for label, _ in pixels]

    def stands_out(picture: np.ndarray) -> np.ndarray:
        apart = np.zeros(count)
        for channel in range(3):
            within, without = (
                np.bincount(label, picture[..., channel][where], minlength=count)
                / np.maximum(number, 1)
                for (label, where), number in zip(pixels, counts, strict=True)
            )
            apart += (within - without) ** 2
        return apart

    return (counts[1] > 0) & (stands_out(image) < GHOST**2 * stands_out(background))


class _Totals:
    """Sums and weighted means over the pixels of each region."""

    def __init__(self, label: np.ndarray, count: int, weight: np.ndarray) -> None:
        self.label, self.count, self.weight = label, count, weight
        self.mass = self.sum(weight)

    def sum(self, value: np.ndarray | None = None) -> np.ndarray:
        return np.bincount(self.label, value, minlength=self.count).astype(float)

    def mean(self, value: np.ndarray) -> np.ndarray:
        return self.sum(self.weight * value) / self.mass


def _measured(
    totals: _Totals,
    x: np.ndarray,
    y: np.ndarray,
    change: np.ndarray,
    pixels: np.ndarray,
    coloured: np.ndarray,
) -> Blobs:
    import cv2

    centre = np.stack([totals.mean(x), totals.mean(y)], 1)
    dx, dy = x - centre[totals.label, 0], y - centre[totals.label, 1]
    xx, yy, xy = (totals.mean(v) for v in (dx * dx, dy * dy, dx * dy))
    middle, apart = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    minor, major = (2 * np.sqrt(middle + sign * apart + PIXEL) for sign in (-1, 1))
    area = totals.sum()
    compact = np.minimum(1.0, area / (np.pi * minor * major)) * np.minimum(1, 3 * minor / major)
    shade = np.stack([totals.mean(pixels[:, i]) for i in range(3)], 1) / 255
    if len(shade):
        shade = cv2.cvtColor(shade[None].astype(np.float32), cv2.COLOR_RGB2Lab)[0] / NOTICED
    lit = 1 - np.minimum(1, COLOURED * totals.sum(coloured) / area)
    size, colour = np.sqrt(area / np.pi), shade.astype(float)
    return Blobs(centre, totals.sum(change), size, minor, colour, compact, lit)
