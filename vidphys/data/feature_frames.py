"""Feature frames against the frames of the clip: a video encoder has one for several of them.

A readout has a query for each body in each frame that a feature frame stands for.
"""

from __future__ import annotations

import torch
from torch import Tensor

from binders.tracks import Tracks


def frame_targets(tracks: Tracks, features: int, each: int) -> tuple[Tensor, Tensor]:
    """What a readout is to say at each feature frame of a clip, and how much it counts.

    Args:
        tracks: one episode of ``t`` frames.
        features: feature frames of the clip.
        each: frames that one stands for. Those that lie beyond the end of the clip do not count.

    Returns:
        Positions ``(features, each * n, 2)`` and weights ``(features, each * n)``.
    """
    frame = torch.arange(features * each)
    inside = frame < len(tracks.times)
    at = frame.clamp_max(len(tracks.times) - 1)
    weight = tracks.confidence[0, at] * inside[:, None]
    positions = tracks.positions[0, at].unflatten(0, (features, each))
    return positions.flatten(1, 2), weight.unflatten(0, (features, each)).flatten(1, 2)
