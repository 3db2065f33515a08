"""A clip on disk to features in a store, decoded and encoded only where they are not there yet."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from encoders.features import FeatureMap
from encoders.identity import IdentifiedEncoder, LayeredEncoder
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
    request = _request(video, encoder, dtype, axes)
    before = store.hits

    def encode() -> FeatureMap:
        return encoder(*_shown(video, axes), _told(progress))

    features = store.get(request, str(video.path), encode)
    return Extraction(features, request.key, store.hits > before)


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
    requests = {layer: _request(video, at, dtype, ()) for layer, at in single.items()}
    missing = [layer for layer, request in requests.items() if not store.has(request)]
    made: dict[str, FeatureMap] = {}
    if missing:
        made = encoder.encode_layers(*_shown(video, ()), missing, _told(progress))
    found = {}
    for layer, request in requests.items():
        features = store.get(request, str(video.path), partial(made.pop, layer))
        found[layer] = Extraction(features, request.key, layer not in missing)
    return found


def mirrored(frames: Tensor, axes: Axes) -> Tensor:
    """Frames ``(..., H, W)`` mirrored along some of their last two axes."""
    return frames.flip(axes) if axes else frames


def _request(
    video: Video, encoder: IdentifiedEncoder, dtype: StoredDtype, axes: Axes
) -> FeatureRequest:
    source = f"{video.sha256} mirrored along {axes}"
    return FeatureRequest(
        encoder=encoder.identity,
        source_sha256=hashlib.sha256(source.encode()).hexdigest() if axes else video.sha256,
        frames=tuple(int(i) for i in video.indices),
        times=tuple(float(t) for t in video.times),
        frame_size=video.size,
        dtype=dtype,
    )


def _shown(video: Video, axes: Axes) -> tuple[Tensor, Tensor]:
    """What the encoder is given: bytes until one of its passes, so that no clip is all floats."""
    frames = torch.from_numpy(video.frames).permute(0, 3, 1, 2)[None]
    return mirrored(frames, axes), torch.from_numpy(video.times)


def _told(progress: Progress | None) -> Callable[[int, int], None] | None:
    if progress is None:
        return None
    return lambda done, total: progress(done, total, 0.0)
