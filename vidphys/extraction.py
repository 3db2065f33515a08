"""A clip on disk to features in a store, decoded and encoded only where they are not there yet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import torch
from torch import Tensor

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore
from vidphys.train import Progress
from vidphys.video import Video

FRAMES_AT_ONCE = 64

StoredDtype = Literal["float16", "bfloat16", "float32"]


class FrozenEncoder(Protocol):
    """An encoder that can say what its features depend on."""

    identity: EncoderIdentity

    def __call__(self, frames: Tensor, times: Tensor) -> FeatureMap: ...


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
    encoder: FrozenEncoder,
    store: FeatureStore,
    dtype: StoredDtype = "float16",
    progress: Progress | None = None,
) -> Extraction:
    """The features of a clip, from the store or else by the encoder.

    Args:
        video: the decoded clip.
        encoder: a frozen image encoder (frame by frame).
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


def _encode(video: Video, encoder: FrozenEncoder, progress: Progress | None) -> FeatureMap:
    """Encode a few frames at a time, so that a long clip never exists in floats as a whole."""
    times = torch.from_numpy(video.times)
    parts = []
    for start in range(0, len(video.frames), FRAMES_AT_ONCE):
        part = slice(start, start + FRAMES_AT_ONCE)
        frames = torch.from_numpy(video.frames[part]).permute(0, 3, 1, 2)[None].float() / 255
        parts.append(encoder(frames, times[part]))
        if progress is not None:
            progress(min(part.stop, len(video.frames)), len(video.frames), 0.0)
    values = torch.cat([p.values for p in parts], 1)
    return FeatureMap(values, parts[0].stride, times)
