"""A hand-made binder for real clips: whatever moves before a still background is a body.

Per frame: undo the camera's drift, subtract the background, forget what a shadow explains, take
the blobs that hold the most change and have no thin parts (a string is thin), and follow them by
the least acceleration. Nothing is learned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from scipy import ndimage

from binders.base import BINDERS, MotionTracks
from binders.camera import background_of, camera_drift, undo_drift
from binders.follow import Blobs, Path, follow
from binders.tracks import Tracks

SAMPLED_FRAMES = 48
WORKING_SIDE = 400
CANDIDATES = 6
NOISE_SIGMAS = 6.0
LEAST_CHANGE = 10.0
MISALIGNED = 0.5  # pixels
HIDING = 2.5
PASSES = 2


@BINDERS.register("motion")
@dataclass(frozen=True)
class MotionBinder:
    """Follows the moving bodies of a clip before a background that stands (nearly) still.

    Args:
        bodies: how many bodies to follow.
        shadow: a pixel whose colour is the background's times a factor between this and its
            inverse counts as lit differently, not as a body; 1 keeps every change (for bodies
            that differ from their background in brightness alone).
        thin: structures thinner than this many pixels (of the working image, at most 400 on its
            longer side) belong to no body: strings, rods, edges.

    Raises:
        ValueError: numbers outside these ranges.

    Example:
        >>> frames = np.zeros((12, 48, 64, 3), np.uint8)
        >>> for t in range(12):
        ...     frames[t, 20:28, 4 + 4 * t : 12 + 4 * t] = 255
        ...
        >>> found = MotionBinder(bodies=1, shadow=1.0)(frames, np.arange(12) / 30)
        >>> [round(x, 2) for x in found.tracks.positions[0, [0, 11], 0, 0].tolist()]  # half sides
        [-0.75, 0.62]
    """

    bodies: int = 1
    shadow: float = 0.6
    thin: int = 3

    def __post_init__(self) -> None:
        if self.bodies < 1:
            raise ValueError(f"bodies {self.bodies}: follow at least 1")
        if not 0 < self.shadow <= 1:
            raise ValueError(f"shadow {self.shadow}: must be above 0 and at most 1")

    def __call__(
        self, frames: UInt8[np.ndarray, "t h w 3"], times: Float[np.ndarray, " t"]
    ) -> MotionTracks:
        """See :class:`binders.base.Binder`.

        Raises:
            ValueError: fewer than three frames, or no frame in which all bodies are seen.
        """
        if len(frames) < 3:
            raise ValueError(f"MotionBinder: motion needs at least 3 frames, got {len(frames)}")
        small, factor = _working_copy(frames)
        sample, drift = _drift(small)
        path = _follow_before_background(_steady(small, drift), sample, self)
        half = max(frames.shape[1:3]) / 2 / factor
        centre = np.array([frames.shape[2], frames.shape[1]]) / 2 / factor
        up = np.array([1.0, -1.0])
        positions = (path.positions + drift[:, None] + 0.5 - centre) / half * up
        tracks = Tracks(
            torch.from_numpy(positions)[None].float(),
            torch.from_numpy(path.confidence)[None].float(),
            torch.from_numpy(times),
        )
        return MotionTracks(tracks, torch.from_numpy(drift / half * up).float(), path.others)


def camera_path(frames: UInt8[np.ndarray, "t h w 3"]) -> Float[torch.Tensor, "t 2"]:
    """What the camera of a clip did, as in :class:`MotionTracks`, without following anything."""
    small, factor = _working_copy(frames)
    _, drift = _drift(small)
    half = max(frames.shape[1:3]) / 2 / factor
    return torch.from_numpy(drift / half * np.array([1.0, -1.0])).float()


def _working_copy(frames: np.ndarray) -> tuple[np.ndarray, int]:
    """The frames at their working size, and the factor that they were shrunk by."""
    factor = -(-max(frames.shape[1:3]) // WORKING_SIDE)
    return _shrink(frames, factor), factor


def _drift(small: np.ndarray) -> tuple[list[int], np.ndarray]:
    """The frames that the background is known by, and its displacement in each frame (pixels)."""
    sample = np.unique(np.linspace(0, len(small) - 1, SAMPLED_FRAMES).astype(int)).tolist()
    return sample, camera_drift(small.mean(-1, dtype=np.float32), sample)


def _follow_before_background(still: np.ndarray, sample: list[int], settings: MotionBinder) -> Path:
    """Tracks before the background, which is cleaned of the bodies' ghosts once they are known."""
    sampled = still[sample].astype(np.float32)
    hidden = None
    for _ in range(PASSES):
        scenery = _Scenery(background_of(sampled, hidden), settings.shadow)
        threshold = _threshold(np.stack([scenery.change(image) for image in sampled[::4]]))
        blobs = [_blobs(scenery.change(image), threshold, settings) for image in still]
        path = follow(blobs, settings.bodies)
        hidden = _discs(path.positions[sample], HIDING * path.radius, still.shape[1:3])
    return path


def _shrink(frames: np.ndarray, factor: int) -> np.ndarray:
    """Block means as bytes, one frame at a time (a float copy of a whole clip would not fit)."""
    h, w = (n // factor * factor for n in frames.shape[1:3])
    small = np.empty((len(frames), h // factor, w // factor, 3), np.uint8)
    for out, frame in zip(small, frames, strict=True):
        rows = frame[:h].reshape(h // factor, factor, -1, 3).sum(1, dtype=np.float32)
        blocks = rows[:, :w].reshape(h // factor, w // factor, factor, 3).sum(2)
        out[:] = np.rint(blocks / factor**2)
    return small


def _steady(frames: np.ndarray, drift: np.ndarray) -> np.ndarray:
    """The frames as a camera without drift would have seen them, as bytes."""
    still = np.empty_like(frames)
    for out, frame, shift in zip(still, frames, drift, strict=True):
        out[:] = np.rint(undo_drift(frame.astype(np.float32), shift))
    return still


class _Scenery:
    """What stands still, and how much an image differs from it."""

    def __init__(self, background: np.ndarray, shadow: float) -> None:
        self.background, self.shadow = background, shadow
        self.power = np.maximum(_dot(background, background), 1.0)
        down, right = np.gradient(background, axis=(0, 1))
        self.slack = MISALIGNED * np.sqrt(_dot(down, down) + _dot(right, right))

    def change(self, image: np.ndarray) -> np.ndarray:
        """Distance in RGB from the background under the light that explains the pixel best.

        Less what a small misalignment makes of an edge of the background.
        """
        image = image.astype(np.float32)
        light = _dot(image, self.background) / self.power
        light = np.clip(light, self.shadow, 1 / self.shadow)
        rest = image - light[..., None] * self.background
        return np.maximum(np.sqrt(_dot(rest, rest)) - self.slack, 0)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("hwc,hwc->hw", a, b)


def _threshold(change: np.ndarray) -> float:
    middle = float(np.median(change))
    spread = 1.4826 * float(np.median(np.abs(change - middle)))
    return max(LEAST_CHANGE, middle + NOISE_SIGMAS * spread)


def _blobs(change: np.ndarray, threshold: float, settings: MotionBinder) -> Blobs:
    """The compact regions of a frame that changed most, with their weighted centroids.

    One that the picture's edge cuts is left out: the middle of what is seen of it is not its own,
    and it may be the hand or the person that set things going.
    """
    core = ndimage.binary_opening(change > threshold, np.ones((settings.thin,) * 2, bool))
    edge = np.ones(core.shape, bool)
    edge[1:-1, 1:-1] = False
    core &= ~ndimage.binary_propagation(core & edge, mask=core)
    labels, count = ndimage.label(core)
    y, x = np.nonzero(core)
    label, change = labels[y, x] - 1, change[y, x]

    def total(value: np.ndarray | None) -> np.ndarray:
        return np.bincount(label, value, minlength=count).astype(float)

    # the weight saturates, so that texture and highlights inside a body do not move its centroid
    weight = np.clip((change - threshold) / threshold, 0.01, 1.0)
    centre = np.stack([total(weight * x), total(weight * y)], 1) / total(weight)[:, None]
    energy, radius = total(change), np.sqrt(total(None) / np.pi)
    strongest = np.argsort(-energy)[:CANDIDATES]
    return Blobs(centre[strongest], energy[strongest], radius[strongest])


def _discs(positions: np.ndarray, radius: float, size: tuple[int, int]) -> np.ndarray:
    """Where bodies of ``radius`` pixels are, ``(t, h, w)`` boolean."""
    y, x = np.ogrid[: size[0], : size[1]]
    hidden = np.zeros((len(positions), *size), bool)
    for frame, bodies in zip(hidden, positions, strict=True):
        for px, py in bodies:
            frame |= (x - px) ** 2 + (y - py) ** 2 <= radius**2
    return hidden
