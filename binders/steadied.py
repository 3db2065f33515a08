"""A clip as a camera that stands would have seen it."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float

from binders.bars import without_bars
from binders.base import Pictures
from binders.camera import background_of, camera_drift, turned_by, undo_drift
from binders.exposure import evenly_lit
from binders.pan import through, turning, unturned
from binders.reel import Masks, Reel, Through, filled

SAMPLED_FRAMES = 48
WORKING_SIDE = 480
UP = np.array([1.0, -1.0])  # from rows that count downwards


class Steadied:
    """The clip at its working size, and as a camera without drift would have seen it.

    Args:
        frames: RGB, row 0 on top.
        times: seconds.

    Attributes:
        still: RGB bytes ``(t, h, w, 3)`` of the working size, evenly lit, before a background that
            stands; in a file where they are many.
        sample: frames that the background is known by.
        drift: of the background, ``(t, 2)`` pixels of the working image; where the camera turns
            far, that of the picture's middle from the first frame on.
        factor: by which the frames were shrunk.
        steps: times in units of the usual interval.
        half: of the longer side, pixels of the working image.

    Raises:
        ValueError: fewer than three frames.
    """

    def __init__(self, frames: Pictures, times: Float[np.ndarray, " t"]) -> None:
        if len(frames) < 3:
            raise ValueError(f"MotionBinder: motion needs at least 3 frames, got {len(frames)}")
        small, self.factor = _working_copy(frames)
        self.half = max(frames.shape[1:3]) / 2 / self.factor
        self._middle = np.array([frames.shape[2], frames.shape[1]]) / 2 / self.factor
        self.sample = _sample(len(small))
        small = without_bars(small, self.sample)
        self._turns, self.drift = _moved(small, self.sample)
        if self._turns is None:
            self.still = _steady(small, self.drift)
        else:
            self.still = _filled(*unturned(small, self._turns), self.sample)
        self.still = evenly_lit(self.still, self.sample)
        self.steps = (times - times[0]) / np.median(np.diff(times))

    def seen(self, places: Float[np.ndarray, "t n 2"]) -> Float[np.ndarray, "t n 2"]:
        """Places before the still background, as the first frame's camera sees them, and drifted.

        Without :attr:`drift` they are as a camera that stands sees them.
        """
        if self._turns is not None:
            places = through(np.broadcast_to(self._turns[0], self._turns.shape), places)
        return places + self.drift[:, None]

    @property
    def camera(self) -> Float[torch.Tensor, "t 2"]:
        """What the camera did, as in :class:`MotionTracks`."""
        return _since_first(self.drift, self.half)

    def normalised(self, pixels: Float[np.ndarray, "*t 2"]) -> Float[np.ndarray, "*t 2"]:
        """Working pixels in normalised image units, y upwards."""
        return (pixels + 0.5 - self._middle) / self.half * UP


def camera_path(frames: Pictures) -> Float[torch.Tensor, "t 2"]:
    """What the camera of a clip did, as in :class:`MotionTracks`, without following anything."""
    small, factor = _working_copy(frames)
    sample = _sample(len(small))
    _, drift = _moved(without_bars(small, sample), sample)
    return _since_first(drift, max(frames.shape[1:3]) / 2 / factor)


def _since_first(drift: np.ndarray, half: float) -> Float[torch.Tensor, "t 2"]:
    """The camera's path from the first frame on, normalised image units."""
    return torch.from_numpy((drift - drift[0]) / half * UP).float()


def _working_copy(frames: Pictures) -> tuple[Reel, int]:
    """The frames at their working size, and the factor that they were shrunk by."""
    import cv2

    factor = -(-max(frames.shape[1:3]) // WORKING_SIDE)
    h, w = (n // factor for n in frames.shape[1:3])
    if factor == 1:
        return filled(frames), 1
    whole = (frame[: h * factor, : w * factor] for frame in frames)
    small = (cv2.resize(frame, (w, h), interpolation=cv2.INTER_AREA) for frame in whole)
    return filled(small), factor


def _sample(count: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, SAMPLED_FRAMES).astype(int)).tolist()


def _moved(small: Reel, sample: list[int]) -> tuple[np.ndarray | None, np.ndarray]:
    """What the camera did: homographies if it turned or rolled, and the drift of the middle."""
    turns = turning(small)
    if turns is None:
        grey = Through(small, lambda frame: frame.mean(-1, dtype=np.float32))
        drift = camera_drift(grey, sample)
        if not drift[:, 2].any():
            return None, drift[:, :2]
        turns = turned_by(drift, (small.shape[1], small.shape[2]))
    return turns, _turned(turns, np.array(small.shape[2:0:-1]) / 2)


def _turned(turns: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Displacement of the picture's middle from the first frame on."""
    places = through(turns, np.tile(middle, (len(turns), 1, 1)))[:, 0]
    drift: np.ndarray = places - places[0]
    return drift


def _steady(frames: Reel, drift: np.ndarray) -> Reel:
    """The frames as a camera without drift would have seen them, as bytes."""
    return filled(
        np.rint(undo_drift(frame.astype(np.float32), shift)).astype(np.uint8)
        for frame, shift in zip(frames, drift, strict=True)
    )


def _filled(still: Reel, shown: Masks, sample: list[int]) -> Reel:
    """The frames with the background where the camera did not look."""
    hidden = ~np.stack([shown[k] for k in sample])
    behind = background_of(still[sample].astype(np.float32), hidden).astype(np.uint8)
    return filled(np.where(shown[k][..., None], frame, behind) for k, frame in enumerate(still))
