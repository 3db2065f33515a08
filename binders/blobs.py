"""Candidate bodies of one frame."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Shaped

GROWN = 1.3  # logarithm of the change of area beyond which a blob is not the body
RECOLOURED = 1.5  # in units of :attr:`Blobs.colour`


@dataclass(frozen=True)
class Blobs:
    """Candidate bodies of one frame.

    Args:
        centre: ``(k, 2)``, (x, y) in pixels, y downwards.
        energy: how much changed there, ``(k,)``, arbitrary unit.
        size: radius of the disc of the same area, pixels, ``(k,)``.
        radius: half its narrower width, pixels, ``(k,)``; a fast body's streak keeps it.
        colour: ``(k, 3)``, in Lab, in units of a difference that is noticed.
        compact: 1 where it is a disc or an ellipse, less where it is long or has arms, ``(k,)``.
        lit: 1 where it differs from the background in brightness alone, as a shadow does, ``(k,)``;
            less where part of it differs in more.
    """

    centre: Float[np.ndarray, "k 2"]
    energy: Float[np.ndarray, " k"]
    size: Float[np.ndarray, " k"]
    radius: Float[np.ndarray, " k"]
    colour: Float[np.ndarray, "k 3"]
    compact: Float[np.ndarray, " k"]
    lit: Float[np.ndarray, " k"]

    def __len__(self) -> int:
        """Number of candidates."""
        return len(self.energy)

    def only(self, which: Bool[np.ndarray, " k"]) -> Blobs:
        """Some of them."""
        return Blobs(*(getattr(self, field.name)[which] for field in fields(self)))

    def moved(self, right: int, down: int) -> Blobs:
        """The same, so many pixels further."""
        return replace(self, centre=self.centre + [right, down])

    def unlike(
        self, colour: Float[np.ndarray, "*m 3"], size: Shaped[np.ndarray, "*m"] | float
    ) -> Float[np.ndarray, "*m k"]:
        """How much each differs in looks from something; 1 is as much as one body may."""
        shade = np.linalg.norm(self.colour - colour[..., None, :], axis=-1) / RECOLOURED
        grown = 2 * np.abs(np.log(self.size / np.asarray(size)[..., None])) / GROWN
        return np.maximum(shade, grown)
