"""Coloured disks that several fronts look at: clips, bytes and true positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from encoders.features import FeatureMap
from renderers import Camera, RgbWorld
from vidphys.clips import Clips, render_clips
from vidphys.trade.context import Context

IMAGE, FRAMES, STRIDE = 64, 8, 40  # pixels, frames of a clip, reference steps between them
TRAIN_SHARE = 0.75
RIDGE = 1e-3  # of the features' mean power


def coloured_clips(context: Context) -> Clips:
    """Clips of three coloured disks, 0.08 s from frame to frame."""
    world = RgbWorld(Camera(height=IMAGE, width=IMAGE))
    clips = context.sizes.labelled
    return render_clips(context.scene, world, clips, FRAMES, STRIDE, context.seed, "trade")


@dataclass(frozen=True)
class Probe:
    """What a linear readout of all cells, fitted to some clips, says of the others.

    Args:
        clips: see :func:`coloured_clips`.
        pooling: cells along each side of what is averaged before.
    """

    clips: Clips
    pooling: int = 1

    def nmse(self, features: FeatureMap) -> float:
        """Squared error of positions in all frames over their variance, on held-out clips.

        Frames that the encoder did not see, or saw several of at once, are read between its
        feature frames.
        """
        train = round(TRAIN_SHARE * len(self.clips))
        seen = self._rows(features.values)
        truth = self.clips.states.q.flatten(-2)
        at = torch.stack([between(self.clips.times, clip, features.times) for clip in truth])
        said = ridge(
            seen[:train].flatten(0, 1), at[:train].flatten(0, 1), seen[train:].flatten(0, 1)
        ).unflatten(0, (len(truth) - train, -1))
        told = torch.stack([between(features.times, clip, self.clips.times) for clip in said])
        truth = truth[train:]
        return float((told - truth).square().mean() / truth.var(correction=0))

    def _rows(self, values: Tensor) -> Tensor:
        """All cells of each feature frame as one row, ``(b, t, c * h * w)``."""
        pooled = values.flatten(0, 1).double()
        if self.pooling > 1:
            pooled = torch.nn.functional.avg_pool2d(pooled, self.pooling)
        return pooled.flatten(1).unflatten(0, values.shape[:2])


def ridge(seen: Tensor, known: Tensor, asked: Tensor) -> Tensor:
    """Linear regression of ``known`` (m, k) on ``seen`` (m, f), at ``asked`` (l, f)."""
    centre, mean = seen.mean(0), known.mean(0)
    seen, asked = seen - centre, asked - centre
    kernel = seen @ seen.T
    power = kernel.diagonal().mean().clamp_min(1e-30)
    weights = torch.linalg.solve(kernel + RIDGE * power * torch.eye(len(seen)), known - mean)
    return asked @ (seen.T @ weights) + mean


def between(times: Tensor, values: Tensor, wanted: Tensor) -> Tensor:
    """Linear interpolation of ``values`` (t, k) at other times; the ends stay as they are."""
    columns = [np.interp(wanted.numpy(), times.numpy(), column) for column in values.T.numpy()]
    return torch.from_numpy(np.stack(columns, -1))


def encoded(encoder: Any, clips: Clips) -> FeatureMap:
    """Features of all clips."""
    return encoder(clips.frames, clips.times)


def multiply_adds(work: Callable[[], object]) -> float:
    """Multiply-adds of one call, as torch counts its matrix products and convolutions."""
    from torch.utils.flop_counter import FlopCounterMode

    with FlopCounterMode(display=False) as counter:
        work()
    return counter.get_total_flops() / 2
