"""Coloured disks that several fronts look at: clips, bytes and true positions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from encoders.features import FeatureMap
from renderers import Camera, RgbWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.placement import CPU, moved
from vidphys.trade.context import Context

IMAGE, FRAMES, STRIDE = 64, 8, 40  # pixels, frames of a clip, reference steps between them
TRAIN_SHARE = 0.75
RIDGE = 1e-3  # of the features' mean power
CELLS = 3000  # that the scores are fitted to
LEAST_WIDTH = 0.1  # normalised image units: of the hill that a body's scores should be
SHARPNESS = 3  # power of a score in the mean place


def coloured_clips(context: Context) -> Clips:
    """Clips of three coloured disks, 0.08 s from frame to frame."""
    world = RgbWorld(Camera(height=IMAGE, width=IMAGE))
    clips = context.sizes.labelled
    return render_clips(context.scene, world, clips, FRAMES, STRIDE, context.seed, "trade")


@dataclass(frozen=True)
class Probe:
    """What a linear map of single cells, fitted to some clips, says of bodies in the others.

    Each cell gives each body a score, the same map for all cells, taught to be high where the body
    is; the body is where the scores lie, up to an affine map. All of it is in closed form.

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
        seen = self._pooled(features)
        train = round(TRAIN_SHARE * len(self.clips))
        truth = self.clips.states.q / self.clips.world.camera.half_extent
        at = between(self.clips.times, truth, features.times)
        values, centres = seen.values.double(), seen.cell_centres().double()
        scores = _scores(values[:train], at[:train], centres)(values)
        found = _centre(scores, centres)
        said = _straightened(found[:train], at[:train])(found)
        told = between(features.times, said, self.clips.times)[train:]
        return float((told - truth[train:]).square().mean() / truth[train:].var(correction=0))

    def _pooled(self, features: FeatureMap) -> FeatureMap:
        if self.pooling == 1:
            return features
        flat = torch.nn.functional.avg_pool2d(features.values.flatten(0, 1), self.pooling)
        values = flat.unflatten(0, features.values.shape[:2])
        down, right, *border = features.stride
        stride = down * self.pooling, right * self.pooling, *border
        return FeatureMap(values, stride, features.times)


def _scores(values: Tensor, at: Tensor, centres: Tensor) -> Callable[[Tensor], Tensor]:
    """From features (b, t, c, h, w) to a score of each cell for each body, (b, t, h, w, n)."""
    width = max(
        LEAST_WIDTH,
        float((centres[..., 0, 0] - centres[..., -1, 0]).abs().max())
        / max(1, centres.shape[1] - 1),
    )
    apart = centres[:, :, None] - at[:, :, None, None]
    wanted = (-apart.square().sum(-1) / (2 * width**2)).exp().flatten(0, 3)
    cells = values.movedim(2, -1).flatten(0, 3)
    chosen = torch.randperm(len(cells), generator=torch.Generator().manual_seed(0))[:CELLS]
    weights, offset = ridge(cells[chosen], wanted[chosen])
    return lambda x: x.movedim(2, -1) @ weights + offset


def _centre(scores: Tensor, centres: Tensor) -> Tensor:
    """Where the high scores lie, (b, t, n, 2)."""
    weight = scores.clamp_min(1e-6).pow(SHARPNESS)
    total = torch.einsum("bthwn,hwd->btnd", weight, centres)
    return total / weight.sum((2, 3)).unsqueeze(-1)


def _straightened(found: Tensor, truth: Tensor) -> Callable[[Tensor], Tensor]:
    """An affine map of all bodies' places together: coarse cells pull them inwards."""
    weights, offset = ridge(found.flatten(0, 2), truth.flatten(0, 2))
    return lambda x: x @ weights + offset


def ridge(seen: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Weights (f, k) and offset (k) of the linear regression of ``known`` on ``seen`` (m, f)."""
    centre, mean = seen.mean(0), known.mean(0)
    seen = seen - centre
    square = seen.T @ seen
    damping = RIDGE * square.diagonal().mean().clamp_min(1e-30)
    eye = torch.eye(len(square), dtype=square.dtype)
    weights = torch.linalg.solve(square + damping * eye, seen.T @ (known - mean))
    return weights, mean - centre @ weights


def between(times: Tensor, values: Tensor, wanted: Tensor) -> Tensor:
    """Linear interpolation of ``values`` (b, t, ...) at other times; the ends stay as they are."""
    above = torch.searchsorted(times, wanted.contiguous()).clamp(1, max(1, len(times) - 1))
    if len(times) == 1:
        return values.expand(-1, len(wanted), *values.shape[2:])
    below = above - 1
    share = ((wanted - times[below]) / (times[above] - times[below])).clamp(0, 1)
    share = share.reshape(-1, *[1] * (values.dim() - 2))
    return values[:, below] * (1 - share) + values[:, above] * share


def encoded(encoder: Any, clips: Clips) -> FeatureMap:
    """Features of all clips, on the CPU, wherever they were computed."""
    return moved(encoder(clips.frames, clips.times), CPU)


def multiply_adds(work: Callable[[], object]) -> float:
    """Multiply-adds of one call, as torch counts its matrix products and convolutions."""
    from torch.utils.flop_counter import FlopCounterMode

    with FlopCounterMode(display=False) as counter:
        work()
    return counter.get_total_flops() / 2
