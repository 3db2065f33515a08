"""Feature frames that are read: those of some frames of each clip, under every view of the clip."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import torch
from torch import Tensor
from torch.nn import functional

from vidphys.experiments.pixels.temporal_views import repeated, shuffled
from vidphys.probing.controls import DISORDER, STILL
from vidphys.probing.layers import AllLayers, Maps

View = Callable[[AllLayers, Tensor, Tensor, tuple[int, ...], int], Maps]
GRID = 8  # cells on the longer side, at most, that a map is pooled to
SIDE = 64  # pixels of the longer side that frames are shrunk to before they stand for themselves
PATCH = 8  # pixels on a side of the patches that stand for an encoder that does nothing
BESIDE = 1  # frames before and after the one that is read, which the pixels show as well


def labelled_frames(frames: int, count: int) -> tuple[int, ...]:
    """Numbers of ``count`` frames, evenly spread within a clip.

    Raises:
        ValueError: more than the clip has.

    Example:
        >>> labelled_frames(16, 2)
        (5, 10)
    """
    if not 1 <= count <= frames:
        raise ValueError(f"probe: `each` {count}: a clip has {frames} frames; use 1 to {frames}")
    return tuple(int((k + 1) * (frames - 1) / (count + 1) + 0.5) for k in range(count))


def as_they_are(
    layers: AllLayers, frames: Tensor, times: Tensor, read: tuple[int, ...], grid: int
) -> Maps:
    """Examples of clips, ``(b * read, c, h, w)`` by layer, those of a clip together.

    Args:
        layers: the encoder.
        frames: ``(b, t, c, H, W)``.
        times: seconds, ``(t,)``.
        read: the frames whose feature frames are kept.
        grid: cells on a side that they are pooled to at most.
    """
    if layers.alone:  # the others would be encoded in vain
        frames, times, read = frames[:, read], times[list(read)], tuple(range(len(read)))
    maps = layers(frames, times)
    return {name: _kept(values, frames.shape[1], read, grid) for name, values in maps.items()}


def in_disorder(
    layers: AllLayers, frames: Tensor, times: Tensor, read: tuple[int, ...], grid: int
) -> Maps:
    """As :func:`as_they_are`, the frames that are not read in an order of each clip's own."""
    return as_they_are(layers, shuffled(frames, *read), times, read, grid)


def standing_still(
    layers: AllLayers, frames: Tensor, times: Tensor, read: tuple[int, ...], grid: int
) -> Maps:
    """As :func:`as_they_are`, of clips that show nothing but the frame that is read."""
    parts = [as_they_are(layers, repeated(frames, k), times, (k,), grid) for k in read]
    return {name: torch.stack([part[name] for part in parts], 1).flatten(0, 1) for name in parts[0]}


PLAIN = ""
VIEWS: dict[str, View] = {PLAIN: as_they_are, DISORDER: in_disorder, STILL: standing_still}


def patches(frames: Tensor, read: Iterable[int]) -> Tensor:
    """Pixels of the frames that are read and of those beside them, patch by patch.

    Returns:
        ``(b * read, c, h, w)``; a border that fills no patch is left out.
    """
    last = frames.shape[1] - 1
    shown = [[min(max(k + d, 0), last) for d in range(-BESIDE, BESIDE + 1)] for k in read]
    some = torch.stack([frames[:, index].flatten(1, 2) for index in shown], 1).flatten(0, 1)
    longer = max(frames.shape[-2:])
    height, width = (max(1, round(n * min(1.0, SIDE / longer))) for n in frames.shape[-2:])
    small = functional.adaptive_avg_pool2d(some.float(), (height, width))
    side = min(PATCH, height, width)
    height, width = height // side * side, width // side * side
    return functional.pixel_unshuffle(small[..., :height, :width], side)


def _kept(values: Tensor, frames: int, read: tuple[int, ...], grid: int) -> Tensor:
    index = [k * values.shape[1] // frames for k in read]
    maps = values[:, index].flatten(0, 1).float()
    height, width = (min(side, grid) for side in maps.shape[-2:])
    return functional.adaptive_avg_pool2d(maps, (height, width)).cpu()
