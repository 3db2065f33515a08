"""What bodies look like, measured from clips: for rungs that know only that bodies are blobs.

A blob is a round spot, alike for all bodies, bright in the middle and dark beyond; nothing else is
known of how it is drawn. How bright it is at what distance is read off where blobs stand alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from scipy.interpolate import PchipInterpolator
from torch import Tensor

from binders.palette import unmix
from renderers import AnonymousWorld, Camera
from vidphys.data.clips import Clips
from vidphys.errors import InputError


@dataclass(frozen=True)
class BlobSettings:
    """Of the measurement.

    Args:
        frames: that are looked at, at most.
        lit: part of the brightest light above which a pixel belongs to a blob.
        beyond: radii of a blob within which its light is measured, and nothing else may stand.
        step: pixels between the distances at which light is told.
        least: blobs that stand alone, to measure by.
        full: quantile of a colour's pixels that counts as its full light.
    """

    frames: int = 512
    lit: float = 0.5
    beyond: float = 1.6
    step: float = 0.5
    least: int = 8
    full: float = 0.9


@dataclass(frozen=True, eq=False)
class Profile:
    """Light of a blob by the square of the distance from its middle: a falling cubic spline.

    Args:
        knots: squared distances, world units squared, rising from 0.
        terms: of the cubic in each interval, highest power first, ``(4, k - 1)``.
    """

    knots: Tensor
    terms: Tensor

    @classmethod
    def through(cls, squared: np.ndarray, light: np.ndarray) -> Profile:
        """The spline through measured light; it falls where that does, and ends at 0."""
        falling = np.minimum.accumulate(light.clip(0, 1 - 1e-6))
        falling[-1] = 0.0
        spline = PchipInterpolator(squared, falling)
        return cls(torch.tensor(spline.x).float(), torch.tensor(spline.c).float())

    def __call__(self, squared: Tensor) -> Tensor:
        """Light at squared distances, differentiable; 0 beyond what was measured."""
        knots, terms = self.knots.to(squared), self.terms.to(squared)
        inside = squared.clamp(max=float(self.knots[-1]))
        at = torch.bucketize(inside.detach(), knots[1:-1])
        past = inside - knots[at]
        a, b, c, d = terms[:, at]
        return ((a * past + b) * past + c) * past + d


@dataclass(frozen=True, eq=False)
class BlobWorld:
    """Pictures of blobs of a measured look; where they overlap, as much of each shows as fits.

    Args:
        camera: the pixel grid.
        coverage: light of one blob at a squared distance (world units squared) from its middle.
    """

    camera: Camera
    coverage: Profile

    def __call__(self, q: Tensor) -> Tensor:
        """Frames of blobs at ``q`` (world units), ``(..., n, 2)`` to ``(..., 1, H, W)``."""
        dx, dy = self.camera.offsets(q)
        squared = dy.square().unsqueeze(-1) + dx.square().unsqueeze(-2)
        return 1 - (1 - self.coverage(squared)).prod(-3, keepdim=True)


DrawnWorld = AnonymousWorld | BlobWorld


def measured_world(clips: Clips, settings: BlobSettings = BlobSettings()) -> BlobWorld:
    """The world of clips in one channel, as their pictures show it.

    Raises:
        InputError: too few blobs stand alone.
    """
    camera, bodies = clips.world.camera, clips.params.mass.shape[-1]
    frames = clips.frames.flatten(0, 1)[:, 0]
    few = frames[:: max(1, len(frames) // settings.frames)].float().numpy() / 255
    return BlobWorld(camera, measured_profile(few, bodies, camera, settings))


def measured_profile(
    frames: np.ndarray, bodies: int, camera: Camera, settings: BlobSettings = BlobSettings()
) -> Profile:
    """How bright a blob is, from those that stand alone.

    Args:
        frames: light in [0, 1] of all bodies together, ``(f, H, W)``.
        bodies: in each.
        camera: of the frames.

    Raises:
        InputError: too few blobs stand alone.
    """
    found = [one for frame in frames for one in _alone(frame, bodies, settings)]
    if len(found) < settings.least:
        raise InputError(
            f"blobs: {len(found)} bodies stand alone in {len(frames)} frames, and "
            f"{settings.least} are needed to measure what a body looks like; use more clips"
        )
    distance, light = (np.concatenate(parts) for parts in zip(*found, strict=True))
    bins = np.round(distance / settings.step).astype(int)
    count = np.bincount(bins)
    kept = np.flatnonzero(count)
    # the middle of what fell into each, and the light there
    where = np.bincount(bins, distance)[kept] / count[kept]
    mean = np.bincount(bins, light)[kept] / count[kept]
    where[0] = 0.0
    return Profile.through((where * camera.units_per_pixel) ** 2, mean)


def _alone(
    frame: np.ndarray, bodies: int, how: BlobSettings
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Distances from the middle (pixels) and light around each blob that stands alone."""
    labels, count = ndimage.label(frame > how.lit * frame.max())
    if count != bodies or frame.max() == 0:
        return  # some stand together
    rows, columns = np.indices(frame.shape)
    numbers = np.arange(1, count + 1)
    middles = np.array(ndimage.center_of_mass(frame, labels, numbers))
    radii = np.sqrt(ndimage.sum_labels(np.ones_like(frame), labels, numbers) / np.pi)
    reach = how.beyond * radii.max() + 1
    for here, middle in enumerate(middles):
        others = np.delete(middles, here, 0)
        edge = np.minimum(middle, np.array(frame.shape) - 1 - middle).min()
        if edge < reach or (np.linalg.norm(others - middle, axis=1) < 2 * reach).any():
            continue
        distance = np.hypot(rows - middle[0], columns - middle[1])
        near = distance < reach
        light = np.where(near, frame, 0.0)  # its middle again, by all of its light
        middle = np.array(ndimage.center_of_mass(light))
        distance = np.hypot(rows - middle[0], columns - middle[1])
        near = distance < reach
        yield distance[near], frame[near]


@dataclass(frozen=True)
class Colours:
    """Blobs of one colour each, as pictures show them.

    Args:
        palette: (r, g, b) of each body, by hue.
        coverage: light of one blob, see :class:`BlobWorld`.
    """

    palette: tuple[tuple[float, float, float], ...]
    coverage: Profile


def measured_colours(clips: Clips, settings: BlobSettings = BlobSettings()) -> Colours:
    """The colours of clips, numbered by hue from red on, and how bright a blob is.

    Raises:
        InputError: too few blobs stand alone, or the bright pixels are of fewer colours.
    """
    bodies = clips.params.mass.shape[-1]
    frames = clips.frames.flatten(0, 1)
    few = frames[:: max(1, len(frames) // settings.frames)].float() / 255
    pixels = few.movedim(1, -1).flatten(0, 2)
    lit = pixels[pixels.amax(-1) > settings.lit * float(pixels.max())]
    size = lit.norm(dim=-1)
    hues = _grouped(lit / size[:, None], bodies)
    nearest = torch.cdist(lit / size[:, None], hues).argmin(1)
    full = torch.stack([size[nearest == k].quantile(settings.full) for k in range(bodies)])
    ordered = sorted((hues * full[:, None]).tolist(), key=_hue)
    palette = tuple((r, g, b) for r, g, b in ordered)
    light = unmix(few, palette).sum(1).clamp(0, 1).numpy()
    return Colours(palette, measured_profile(light, bodies, clips.world.camera, settings))


def _grouped(points: Tensor, groups: int, rounds: int = 10) -> Tensor:
    """Middles of so many groups of points: each begins at the point farthest from the others'."""
    middles = points[:1]
    for _ in range(groups - 1):
        apart = torch.cdist(points, middles).amin(1)
        middles = torch.cat([middles, points[apart.argmax()][None]])
    if len(middles.unique(dim=0)) < groups:
        raise InputError(f"blobs: bright pixels of fewer colours than {groups}; one is needed each")
    for _ in range(rounds):
        nearest = torch.cdist(points, middles).argmin(1)
        middles = torch.stack([points[nearest == k].median(0).values for k in range(groups)])
    return middles


def _hue(colour: list[float]) -> float:
    """In turns from red on, over green and blue."""
    r, g, b = colour
    return float(np.arctan2(3**0.5 * (g - b), 2 * r - g - b) / (2 * np.pi) % 1.0)
