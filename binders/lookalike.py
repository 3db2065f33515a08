"""A body that no blob shows, as it stands still or touches another, is looked for by its looks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from binders.base import Pictures
from binders.hypotheses import Hypothesis
from binders.placed import vertex

AROUND = 1.3  # of the body's longer half, that is compared
LONGEST = 2.0  # of its mean radius
FILLED = 0.4  # of its area, that changed pixels must fill to be its shape
LIKE = 3.0  # times the usual difference from one frame to the next
LEAST_UNLIKE = 30.0  # squared brightness levels
DISTINCT = 0.5  # of the difference beside it
BESIDE = 0.2  # share of the places around that may look like it
TOUCHED = 0.15  # of its area, that changes around a body if something is at it
FREE = 0.25  # sizes by which a body that goes on as it went may be off its way
FAST = 0.03  # and of the way of a frame
STANDS = 0.3  # sizes that a body moves in a frame that stands
TRIES = 3  # frames in a row without it, after which it is not looked for
SAMPLED = 12  # frames that tell what is usual
AS_LARGE = 0.2  # of its area, by which what changes around it may be more or less, if that is it
FOUND = 0.5  # of the usual energy, which is what confidence stands on


def seen_again(
    body: Hypothesis,
    frames: Pictures,
    changed: Pictures,
) -> Hypothesis:
    """The hypothesis with the frames in which the body is found by its looks.

    Between two frames that show it, it is taken wherever it looks as it did. Before the first and
    after the last, only where it goes on as it went, or stands and nothing touches it: what a hand
    holds or pushes says nothing of a law.

    Args:
        body: as blobs show it, pixels of the frames.
        frames: before a still camera.
        changed: what differs from the background in each.
    """
    seen = np.nonzero(body.seen)[0].tolist()
    search = _Search(body, frames, changed)
    for first, last in zip(seen[:-1], seen[1:], strict=True):
        if last - first > 1:
            middle = (first + last + 1) // 2
            search.go(range(first + 1, middle), between=True)
            search.go(range(last - 1, middle - 1, -1), between=True)
    search.go(range(seen[-1] + 1, len(frames)), between=False)
    search.go(range(seen[0] - 1, -1, -1), between=False)
    return search.found


class _Search:
    def __init__(self, body: Hypothesis, frames: Pictures, changed: Pictures) -> None:
        self.frames, self.changed = frames, changed
        self.size = body.usual_size
        longer = float(np.nanmedian(np.minimum(body.size**2 / body.radius, LONGEST * body.size)))
        self.half = max(2, int(np.ceil(AROUND * longer)))
        y, x = np.ogrid[-self.half : self.half + 1, -self.half : self.half + 1]
        self.disc = x * x + y * y <= longer**2
        self.shapes: dict[int, np.ndarray] = {}
        self.found = replace(body, positions=body.positions.copy(), energy=body.energy.copy())
        self.usual = float(np.nanmedian(body.energy))
        self.unlike = self._usual_difference()
        self.area, self.middle = self._usually()

    def _usually(self) -> tuple[float, np.ndarray]:
        """Area of what changes where it is, and the middle of that from its place."""
        seen = np.flatnonzero(self.found.seen).tolist()
        places = [(k, self.found.positions[k]) for k in seen[:: max(1, len(seen) // SAMPLED)]]
        areas, middles = zip(*(self._stands_out(k, at) for k, at in places), strict=True)
        off = [m - (at - np.rint(at)) for m, (_, at) in zip(middles, places, strict=True)]
        return max(float(np.median(areas)), 1.0), np.median(off, 0)

    def _usual_difference(self) -> float:
        seen = np.nonzero(self.found.seen)[0].tolist()
        pairs = [(a, b) for a, b in zip(seen[:-1], seen[1:], strict=True) if b == a + 1]
        chosen = pairs[:: max(1, len(pairs) // SAMPLED)]
        known = [self._difference(a, b, self.found.positions[b], 1.0) for a, b in chosen]
        least = [k[0] for k in known if k is not None]
        return float(np.median(least)) if least else LEAST_UNLIKE

    def go(self, order: range, between: bool) -> None:
        """Look frame by frame, from where it is known."""
        missed = 0
        sign = order.step
        for frame in order:
            if missed == TRIES:
                return
            known = [k for k in range(frame - sign, frame - 12 * sign, -sign) if self._known(k)][:4]
            if not known:
                return
            guess, speed = self._guess(known, frame)
            at = self._look(known[0], frame, guess, speed, between)
            if at is None:
                missed += 1
                continue
            missed = 0
            self.found.positions[frame] = at
            self.shapes[frame] = self._shape(known[0])
            self.found.energy[frame] = FOUND * self.usual

    def _known(self, frame: int) -> bool:
        return 0 <= frame < len(self.frames) and bool(np.isfinite(self.found.positions[frame, 0]))

    def _guess(self, known: list[int], frame: int) -> tuple[np.ndarray, float]:
        """Where it goes on to, and how far it goes in a frame."""
        places = self.found.positions[known]
        if len(known) == 1:
            return places[0], self.size
        degree = min(2, len(known) - 1)
        since = np.array(known, float) - frame
        fit = np.polynomial.polynomial.polyfit(since, places, degree)
        return fit[0], float(np.linalg.norm(places[0] - places[1]) / abs(known[0] - known[1]))

    def _look(
        self, model: int, frame: int, guess: np.ndarray, speed: float, between: bool
    ) -> np.ndarray | None:
        known = self._difference(model, frame, guess, 2 + self.size + speed)
        if known is None:
            return None
        least, beside, at = known
        if least > LIKE * self.unlike + LEAST_UNLIKE or least > DISTINCT * beside:
            return None
        if not ((at >= 0) & (at <= np.array(self.changed.shape[:0:-1]) - 1)).all():
            return None
        at = self._centred(frame, at)
        goes_on = np.linalg.norm(at - guess) <= 1 + FREE * self.size + FAST * speed
        stands = np.linalg.norm(at - self.found.positions[model]) <= STANDS * self.size
        alone = stands and not self._touched(frame, at, self._shape(model))
        return at if between or goes_on or alone else None

    def _centred(self, frame: int, at: np.ndarray) -> np.ndarray:
        """The place by the middle of what changed there, where that is as large as the body.

        A mark that turns draws the place of what looks alike along, farther in every frame.
        """
        area, middle = self._stands_out(frame, at)
        if area == 0 or abs(np.log(area / self.area)) >= AS_LARGE:
            return at
        return np.asarray(np.rint(at) + middle - self.middle)

    def _stands_out(self, frame: int, at: np.ndarray) -> tuple[float, np.ndarray]:
        """Area of what changed at a place, and its middle from the pixel there; pixels."""
        y, x = np.nonzero(self._changed_around(frame, at) & self.disc)
        if not len(x):
            return 0.0, np.zeros(2)
        return float(len(x)), np.array([x.mean(), y.mean()]) - self.half

    def _shape(self, frame: int) -> np.ndarray:
        """Which pixels around it are the body's."""
        if frame not in self.shapes:
            shape = self._changed_around(frame, self.found.positions[frame]) & self.disc
            few = shape.sum() < FILLED * np.pi * self.size**2
            self.shapes[frame] = self.disc if few else shape
        return self.shapes[frame]

    def _changed_around(self, frame: int, at: np.ndarray) -> np.ndarray:
        """In a square about a place, of which nothing changes outside the picture."""
        (left, top), n = np.rint(at).astype(int) - self.half, 2 * self.half + 1
        changed, out = self.changed[frame], np.zeros((n, n), bool)
        (y0, y1), (x0, x1) = (
            np.clip([first, first + n], 0, side)
            for first, side in zip((top, left), changed.shape, strict=True)
        )
        out[y0 - top : y1 - top, x0 - left : x1 - left] = changed[y0:y1, x0:x1]
        return out

    def _touched(self, frame: int, at: np.ndarray, shape: np.ndarray) -> bool:
        import cv2

        outside = ~cv2.dilate(shape.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        return bool((self._changed_around(frame, at) & outside).sum() > TOUCHED * shape.sum())

    def _difference(
        self, model: int, frame: int, guess: np.ndarray, reach: float
    ) -> tuple[float, float, np.ndarray] | None:
        """Least mean squared difference around ``guess``, that beside it, and its place."""
        import cv2

        patch = _cut(self.frames[model], self.found.positions[model], self.half)
        far = int(np.ceil(reach)) + self.half
        window = _cut(self.frames[frame], guess, far)
        if patch is None or window is None:
            return None
        shape = np.repeat(self._shape(model)[..., None], 3, 2).astype(np.float32)
        pictures = window.astype(np.float32), patch.astype(np.float32)
        cost = cv2.matchTemplate(*pictures, cv2.TM_SQDIFF, mask=shape) / shape.sum()
        y, x = (int(i) for i in np.unravel_index(int(cost.argmin()), cost.shape))
        shift = np.array([vertex(cost[y], x), vertex(cost[:, x], y)])
        corner = np.rint(guess) - far + self.half
        offset = self.found.positions[model] - np.rint(self.found.positions[model])
        return float(cost[y, x]), float(np.quantile(cost, BESIDE)), corner + shift + offset


def _cut(image: np.ndarray, centre: np.ndarray, half: int) -> np.ndarray | None:
    """A square around the nearest pixel; ``None`` where that is not in the picture."""
    import cv2

    x, y = np.rint(centre).astype(int)
    h, w = image.shape[:2]
    if not (0 <= x < w and 0 <= y < h):
        return None
    up, down = max(0, half - y), max(0, y + half + 1 - h)
    left, right = max(0, half - x), max(0, x + half + 1 - w)
    inside = image[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1]
    return cv2.copyMakeBorder(inside, up, down, left, right, cv2.BORDER_REPLICATE)
