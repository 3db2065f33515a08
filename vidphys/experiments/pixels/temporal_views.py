"""Views of a clip that differ in what they tell of time, around one frame that all of them show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Generator, Tensor

from encoders.features import FeatureMap
from encoders.frozen.base import FrozenEncoder
from vidphys.seeding import derive

ENCODED_AT_ONCE = 32  # clips


def as_it_is(frames: Tensor, centre: int) -> Tensor:
    """The clip."""
    return frames


def repeated(frames: Tensor, centre: int) -> Tensor:
    """Every frame is the labelled one: the same computation, and nothing moves."""
    return frames[:, [centre] * frames.shape[1]]


def shuffled(frames: Tensor, *labelled: int) -> Tensor:
    """The labelled frames where they were, and all others in an order of each clip's own."""
    rng = Generator().manual_seed(derive(0, "shuffle"))
    others = [t for t in range(frames.shape[1]) if t not in labelled]
    mixed = frames.clone()
    for clip in range(len(frames)):
        order = torch.randperm(len(others), generator=rng).tolist()
        mixed[clip, others] = frames[clip, [others[i] for i in order]]
    return mixed


VIEWS: dict[str, Callable[[Tensor, int], Tensor]] = {
    "clip": as_it_is,
    "repeated": repeated,
    "shuffled": shuffled,
}


class OneFrame:
    """An encoder of which only the feature frame that belongs to one frame of the clip is kept.

    Args:
        encoder: of images or of video.
        frame: of the clip.
    """

    def __init__(self, encoder: FrozenEncoder, frame: int) -> None:
        self.encoder, self.frame = encoder, frame
        layer = f"{encoder.identity.layer}, feature frame of frame {frame}"
        self.identity = replace(encoder.identity, layer=layer)
        self.frames_per_feature = encoder.windowing.tubelet

    def __call__(self, frames: Tensor, times: Tensor, progress: Any = None) -> FeatureMap:
        """Feature maps ``(b, 1, c, h, w)``."""
        parts = []
        for some in frames.split(ENCODED_AT_ONCE):
            found = self.encoder(some, times)
            index = self.frame * found.values.shape[1] // frames.shape[1]
            kept = slice(index, index + 1)
            parts.append(FeatureMap(found.values[:, kept], found.stride, found.times[kept]))
        values = torch.cat([part.values for part in parts])
        return FeatureMap(values, parts[0].stride, parts[0].times)
