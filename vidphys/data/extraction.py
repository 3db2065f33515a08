"""A clip on disk to features in a store, encoded only where they are not there yet.

Frames are decoded block by block while the network takes them, and features are written as they
are made: neither is ever held whole.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from encoders.features import FeatureMap, FeatureStream
from encoders.identity import IdentifiedEncoder, LayeredEncoder, stream
from encoders.store import FeatureRequest, FeatureStore
from vidphys.data.frames import Frames
from vidphys.data.video import Video
from vidphys.progress import Progress

StoredDtype = Literal["float16", "bfloat16", "float32", "int8"]
Axes = tuple[int, ...]  # of frames (..., H, W) along which they are mirrored


@dataclass(frozen=True)
class Extraction:
    """Features of a clip, and whether they were on disk.

    Args:
        features: one episode, memory-mapped.
        key: of the store's entry.
        cached: nothing was encoded.
    """

    features: FeatureMap
    key: str
    cached: bool


def extract(
    video: Video,
    encoder: IdentifiedEncoder,
    store: FeatureStore,
    dtype: StoredDtype = "float16",
    progress: Progress | None = None,
    axes: Axes = (),
) -> Extraction:
    """The features of a clip, from the store or else by the encoder.

    Args:
        video: the opened clip.
        encoder: a frozen encoder of images or video.
        store: where they are kept.
        dtype: of the stored values.
        progress: called as ``(frames done, frames, 0.0)``.
        axes: of the frames ``(..., H, W)`` along which they are mirrored.
    """
    layer = encoder.identity.layer
    return _extracted(video, encoder, {layer: encoder}, store, dtype, progress, axes)[layer]


def extract_layers(
    video: Video,
    encoder: LayeredEncoder,
    layers: Sequence[int | str],
    store: FeatureStore,
    dtype: StoredDtype = "float16",
    progress: Progress | None = None,
) -> dict[str, Extraction]:
    """Several layers of a clip, those that the store does not have from one pass.

    Each is an entry of its own, the one that :func:`extract` finds for the encoder at that layer.

    Args:
        video, store, dtype, progress: see :func:`extract`.
        encoder: a frozen encoder.
        layers: some of its ``layers``.

    Raises:
        ValueError: a layer that the encoder does not have.
    """
    single = {at.identity.layer: at for at in map(encoder.at, layers)}
    return _extracted(video, encoder, single, store, dtype, progress)


def _extracted(
    video: Video,
    encoder: IdentifiedEncoder,
    single: Mapping[str, IdentifiedEncoder],
    store: FeatureStore,
    dtype: StoredDtype,
    progress: Progress | None,
    axes: Axes = (),
) -> dict[str, Extraction]:
    """By layer, what the encoders that are of that layer alone would give."""
    requests = {layer: request_of(video, at, dtype, axes) for layer, at in single.items()}
    missing: list[str] = []

    def encode(layers: Sequence[str]) -> Iterator[FeatureStream]:
        missing.extend(layers)
        shown, times = partial(pictures, video.frames, axes), torch.from_numpy(video.times)
        return stream(encoder, shown, video.size, times, layers, _told(progress))

    found = store.get_layers(requests, str(video.path), encode, video.made)
    return {
        layer: Extraction(features, requests[layer].key, layer not in missing)
        for layer, features in found.items()
    }


def mirrored(frames: Tensor, axes: Axes) -> Tensor:
    """Frames ``(..., H, W)`` mirrored along some of their last two axes."""
    return frames.flip(axes) if axes else frames


def pictures(frames: Frames, axes: Axes = ()) -> Iterator[Tensor]:
    """The frames of a clip in blocks ``(n, 3, H, W)`` of bytes, as encoders take them."""
    for block in frames.chunks():
        yield mirrored(torch.from_numpy(block).permute(0, 3, 1, 2), axes)


def request_of(
    video: Video,
    encoder: IdentifiedEncoder,
    dtype: StoredDtype,
    axes: Axes = (),
    grid: int | None = None,
) -> FeatureRequest:
    """What features of a clip are filed under.

    Args:
        video, encoder, dtype, axes: see :func:`extract`.
        grid: cells on a side that maps are pooled to at most; as they are where not given.
    """
    source = f"{video.sha256} mirrored along {axes}"
    return FeatureRequest(
        encoder=encoder.identity,
        source_sha256=hashlib.sha256(source.encode()).hexdigest() if axes else video.sha256,
        frames=tuple(int(i) for i in video.indices),
        times=tuple(float(t) for t in video.times),
        frame_size=video.size,
        dtype=dtype,
        grid=grid,
    )


def _told(progress: Progress | None) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    return lambda done, total: progress(done, total, 0.0)
