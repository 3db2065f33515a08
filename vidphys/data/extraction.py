"""A clip on disk to features in a store, decoded and encoded only where they are not there yet."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from encoders.features import FeatureMap
from encoders.identity import IdentifiedEncoder
from encoders.store import FeatureRequest, FeatureStore
from vidphys.data.video import Video
from vidphys.progress import Progress

StoredDtype = Literal["float16", "bfloat16", "float32"]
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
        video: the decoded clip.
        encoder: a frozen encoder of images or video.
        store: where they are kept.
        dtype: of the stored values.
        progress: called as ``(frames done, frames, 0.0)``.
        axes: of the frames ``(..., H, W)`` along which they are mirrored.
    """
    source = f"{video.sha256} mirrored along {axes}"
    request = FeatureRequest(
        encoder=encoder.identity,
        source_sha256=hashlib.sha256(source.encode()).hexdigest() if axes else video.sha256,
        frames=tuple(int(i) for i in video.indices),
        times=tuple(float(t) for t in video.times),
        frame_size=video.size,
        dtype=dtype,
    )
    before = store.hits
    features = store.get(request, str(video.path), lambda: _encode(video, encoder, progress, axes))
    return Extraction(features, request.key, store.hits > before)


def mirrored(frames: Tensor, axes: Axes) -> Tensor:
    """Frames ``(..., H, W)`` mirrored along some of their last two axes."""
    return frames.flip(axes) if axes else frames


def _encode(
    video: Video, encoder: IdentifiedEncoder, progress: Progress | None, axes: Axes
) -> FeatureMap:
    # bytes until a pass of the encoder: a long clip never exists in floats as a whole
    frames = mirrored(torch.from_numpy(video.frames).permute(0, 3, 1, 2)[None], axes)
    times = torch.from_numpy(video.times)
    if progress is None:
        return encoder(frames, times)
    return encoder(frames, times, lambda done, total: progress(done, total, 0.0))
