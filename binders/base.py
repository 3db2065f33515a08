"""What follows the bodies of a real clip, by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float

from binders.tracks import Tracks
from registry import Registry


@runtime_checkable
class Pictures(Protocol):
    """Frames ``(t, h, w, 3)`` of bytes, RGB, row 0 on top: an array, or what is decoded as asked.

    A forward slice is such a sequence too; a number or a list of them gives an array. Going
    through them in order is cheap, and so is rising; ``numpy.asarray`` has them all in memory.
    """

    @property
    def shape(self) -> tuple[int, ...]: ...
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[Any]: ...
    def __getitem__(self, which: Any) -> Any: ...


@dataclass(frozen=True)
class MotionTracks:
    """Tracks of a real clip, and what the camera did meanwhile.

    Args:
        tracks: normalised image units, y upwards, one episode; where a body was not seen its
            position is interpolated and its confidence 0.
        camera: displacement of the still background since the first frame, normalised image
            units, y upwards; subtract it from the positions to have them as a camera that stays
            as it was in the first frame would see them.
        others: share of the frames in which something else moves that is as strong as a body.
        radius: of each body in the picture, ``(t, n)``, normalised image units, which grows as it
            comes nearer; NaN where it is not measured, ``None`` where the binder measures none.
    """

    tracks: Tracks
    camera: Float[torch.Tensor, "t 2"]
    others: float = 0.0
    radius: Float[torch.Tensor, "t n"] | None = None


@runtime_checkable
class Binder(Protocol):
    """Follows the bodies of a clip."""

    def __call__(self, frames: Any, times: Float[np.ndarray, " t"]) -> Tracks | MotionTracks:
        """The tracks of a clip, and the camera's where the binder follows it too.

        Args:
            frames: RGB bytes ``(t, h, w, 3)``, row 0 on top, an array; :class:`Pictures` for a
                binder whose attribute ``streams`` is true.
            times: seconds.

        Raises:
            ValueError: frames in which no body can be followed.
        """
        ...


def bind(binder: Binder, frames: Pictures, times: Float[np.ndarray, " t"]) -> Tracks | MotionTracks:
    """What a binder makes of a clip, which one that does not stream gets whole."""
    return binder(frames if getattr(binder, "streams", False) else np.asarray(frames), times)


# of factories, which are called with bodies=NUMBER and by name with what else they are told
BINDERS: Registry[Callable[..., Binder]] = Registry("binder", "vidphys.binders")
