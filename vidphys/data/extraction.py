"""A clip on disk to features in a store, decoded and encoded only where they are not there yet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch

from encoders.features import FeatureMap
from encoders.identity import IdentifiedEncoder
from encoders.store import FeatureRequest, FeatureStore
from vidphys.data.video import Video
from vidphys.progress import Progress

StoredDtype = Literal["float16", "bfloat16", "float32"]


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
) -> Extraction:
    """The features of a clip, from the store or else by the encoder.

    Args:
        video: the decoded clip.
        encoder: a frozen encoder of images or video.
        store: where they are kept.
        dtype: of the stored values.
        progress: called as ``(frames done, frames, 0.0)``.
    """
    request = FeatureRequest(
        encoder=encoder.identity,
        source_sha256=video.sha256,
        frames=tuple(int(i) for i in video.indices),
        times=tuple(float(t) for t in video.times),
        frame_size=video.size,
        dtype=dtype,
    )
    before = store.hits
    features = store.get(request, str(video.path), lambda: _encode(video, encoder, progress))
    return Extraction(features, request.key, store.hits > before)


def _encode(video: Video, encoder: IdentifiedEncoder, progress: Progress | None) -> FeatureMap:
    # bytes until a pass of the encoder: a long clip never exists in floats as a whole
    frames = torch.from_numpy(video.frames).permute(0, 3, 1, 2)[None]
    times = torch.from_numpy(video.times)
    if progress is None:
        return encoder(frames, times)
    return encoder(frames, times, lambda done, total: progress(done, total, 0.0))
