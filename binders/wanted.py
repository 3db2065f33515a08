"""What a person says of the bodies that are to be followed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Shaped

from binders.hypotheses import Hypothesis

LIKE = 35.0  # distance in Lab within which a pixel has the colour
HUE = np.array([0.5, 1, 1], np.float32)  # weights in it: light changes more than hue
SIZES = 0.4  # of the logarithm of a radius, by which it may differ from what was said
NEAR = 1.5  # sizes, within which a body is at a place
NEAR_PIXELS = 3.0


@dataclass(frozen=True)
class Wanted:
    """Which bodies are to be followed; what is not said is found out.

    Args:
        at: x, y in pixels of the clip, and the frame, where a body is; several of one body or
            of different ones.
        region: x, y, width, height, in pixels of the clip, in which bodies are looked for.
        colour: of the bodies, RGB, 0 to 255.
        size: of the bodies, their diameter in pixels of the clip.
        mask: of the clip's size, true where bodies are looked for.
        choose: numbers, from 1, of the candidates that :meth:`MotionBinder.candidates` lists.
    """

    at: tuple[tuple[float, float, int], ...] = ()
    region: tuple[float, float, float, float] | None = None
    colour: tuple[int, int, int] | None = None
    size: float | None = None
    mask: Bool[np.ndarray, "h w"] | None = None
    choose: tuple[int, ...] = ()

    def require(self, frames: int, height: int, width: int) -> None:
        """Refuse what no clip of this size can show, before anything is looked for.

        Raises:
            ValueError: a frame that is not used, a mask of another size, or a region and a mask
                that leave nothing of the picture.
        """
        for *_, frame in self.at:
            if not 0 <= frame < frames:
                raise ValueError(
                    f"at frame {frame}: the frames that are used are 0 to {frames - 1}"
                )
        self.where(height, width, 1)

    def where(
        self, height: int, width: int, factor: int
    ) -> Bool[np.ndarray, "{height} {width}"] | None:
        """Where bodies are looked for in the working image; ``None`` where that is everywhere.

        Raises:
            ValueError: a mask of another size, or nothing is left to look at.
        """
        if self.region is None and self.mask is None:
            return None
        y, x = factor * (np.mgrid[:height, :width] + 0.5)
        inside = np.ones((height, width), bool)
        if self.region is not None:
            left, top, wide, high = self.region
            inside &= (x >= left) & (x < left + wide) & (y >= top) & (y < top + high)
        if self.mask is not None:
            if not all(
                0 <= m - factor * n < factor
                for m, n in zip(self.mask.shape, inside.shape, strict=True)
            ):
                raise ValueError(
                    f"`mask`: {self.mask.shape[1]}x{self.mask.shape[0]} pixels, the clip has "
                    "another size; draw it on a frame of the clip"
                )
            inside &= self.mask[y.astype(int), x.astype(int)]
        if not inside.any():
            raise ValueError("`region` and `mask` leave nothing of the picture to look at")
        return inside

    def likeness(self, image: Shaped[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w"]:
        """How much each pixel has the colour, 0 to :data:`LIKE`."""
        import cv2

        lab = cv2.cvtColor(image.astype(np.float32) / 255, cv2.COLOR_RGB2Lab)
        pixel = np.array([[self.colour]], np.float32) / np.float32(255)
        apart = (lab - cv2.cvtColor(pixel, cv2.COLOR_RGB2Lab)[0, 0]) * HUE
        return np.maximum(0, LIKE - np.sqrt(cv2.transform(apart * apart, np.ones((1, 3)))))

    def fits(self, body: Hypothesis, factor: int) -> float:
        """How well a hypothesis fits what was said of places and size, 0 to 1."""
        fit = 1.0
        size = body.usual_size
        if self.size is not None:
            fit *= float(np.exp(-0.5 * (np.log(2 * factor * size / self.size) / SIZES) ** 2))
        if self.at and not self.meets(body, factor):
            fit = 0.0
        return fit

    def meets(self, body: Hypothesis, factor: int) -> list[int]:
        """Which of the places the body is at."""
        seen = np.nonzero(body.seen)[0]
        reach = NEAR * body.usual_size + NEAR_PIXELS
        met = []
        for number, (x, y, frame) in enumerate(self.at):
            place = [np.interp(frame, seen, body.positions[seen, axis]) for axis in (0, 1)]
            away = np.linalg.norm(np.array(place) - in_working_pixels(x, y, factor))
            if away < reach and seen[0] <= frame <= seen[-1]:
                met.append(number)
        return met


def in_working_pixels(x: float, y: float, factor: int) -> np.ndarray:
    """A place in pixels of the clip, in those of the working image; both count from a centre."""
    return (np.array([x, y]) + 0.5) / factor - 0.5
