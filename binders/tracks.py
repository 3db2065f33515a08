"""The two types of binding: detections of a frame, and tracks that keep identity."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Detections:
    """Bodies seen in each frame, in no particular order.

    Args:
        positions: ``(b, t, k, 2)``, (x, y) in world units, y upwards.
        confidence: ``(b, t, k)`` in [0, 1]; 0 means that the slot holds no detection.
        times: seconds of each frame, ``(t,)``.
    """

    positions: Float[Tensor, "b t k 2"]
    confidence: Float[Tensor, "b t k"]
    times: Float[Tensor, " t"]


@dataclass(frozen=True)
class Tracks:
    """Bodies followed through time: index ``n`` is one body in every frame.

    Args:
        positions: ``(b, t, n, d)``; in a plane (x, y) in world units, y upwards.
        confidence: ``(b, t, n)`` in [0, 1].
        times: seconds of each frame, ``(t,)``.

    Example:
        >>> import torch
        >>> times = torch.arange(4) * 0.1
        >>> tracks = Tracks(torch.zeros(1, 4, 2, 2), torch.ones(1, 4, 2), times)
        >>> tuple(tracks.positions.shape)  # clips, frames, bodies, space
        (1, 4, 2, 2)
    """

    positions: Float[Tensor, "b t n d"]
    confidence: Float[Tensor, "b t n"]
    times: Float[Tensor, " t"]
