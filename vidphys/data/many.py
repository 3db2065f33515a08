"""Many clips on disk to features in a store: decoded ahead, several in a pass, gone on with."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import torch

from encoders.arrays import bytes_kept
from encoders.entry import Entries, Origin
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.many import ComingClip, ManyClips
from encoders.grid import Size
from encoders.identity import LayeredEncoder, stream
from encoders.store import FeatureRequest
from vidphys.data.ahead import prefetched
from vidphys.data.extraction import StoredDtype, pictures, request_of
from vidphys.data.video import Video


class Kept(Protocol):
    """Where features go: a store, or a part of one."""

    def has(self, request: FeatureRequest) -> bool: ...

    def begin(self, requests: Sequence[FeatureRequest], origin: Origin) -> Entries: ...


@dataclass(frozen=True)
class Wanted:
    """What is to be in the store of each clip.

    Args:
        encoder: a frozen encoder.
        layers: some of its ``layers``.
        store: where features are kept.
        dtype: of the stored values.
        grid: cells on a side that maps are pooled to at most; as they are where not given.
        made: what else an entry's manifest is to say.
    """

    encoder: LayeredEncoder
    layers: Sequence[str]
    store: Kept
    dtype: StoredDtype = "float16"
    grid: int | None = None
    made: Mapping[str, Any] | None = None

    def requests(self, video: Video) -> dict[str, FeatureRequest]:
        """By layer, what is filed."""
        at = {layer: self.encoder.at(layer) for layer in self.layers}
        return {
            layer: request_of(video, each, self.dtype, grid=self.grid) for layer, each in at.items()
        }

    def missing(self, video: Video) -> list[str]:
        """Layers that are not in the store."""
        requests = self.requests(video).items()
        return [layer for layer, request in requests if not self.store.has(request)]


def extract_many(
    videos: Iterable[Video],
    wanted: Wanted,
    done: Callable[[Video, Sequence[str]], None],
    passed: Callable[[int], None] = lambda windows: None,
) -> float:
    """Put the features of all clips into the store; what is there already is not made again.

    Args:
        videos: the opened clips, one after the other.
        wanted: what is to be there.
        done: called with each clip once its features are there, and the layers that were made.
        passed: called with the windows of each pass.

    Returns:
        Seconds that the network was at work.
    """
    encoder = wanted.encoder
    if not isinstance(encoder, FrozenEncoder):
        for video in videos:
            done(video, _made_alone(video, wanted))
        return 0.0
    many = ManyClips(encoder, passed)
    many.encode(_missing(videos, wanted, done))
    return many.busy


def _made_alone(video: Video, wanted: Wanted) -> Sequence[str]:
    """By an encoder that takes one clip at a time; the layers that were not there."""
    requests, layers = wanted.requests(video), wanted.missing(video)
    times, shown = torch.from_numpy(video.times), partial(pictures, video.frames)
    for made in stream(wanted.encoder, shown, video.size, times, layers) if layers else ():
        with _begin(wanted, video, requests, made.size, made.layers, made.times) as entries:
            for piece in made.pieces:
                entries.add(piece)
    return layers


def _missing(
    videos: Iterable[Video], wanted: Wanted, done: Callable[[Video, Sequence[str]], None]
) -> Iterator[ComingClip]:
    """The clips of which something is not there."""
    encoder: Any = wanted.encoder
    for video in videos:
        layers = wanted.missing(video)
        if not layers:
            done(video, ())
            continue
        yield ComingClip(
            chunks=partial(_chunks, video),
            times=torch.from_numpy(video.times),
            layers=layers,
            begin=partial(
                _begin, wanted, video, wanted.requests(video), encoder.framed(video.size)
            ),
            done=partial(done, video, layers),
        )


def _begin(
    wanted: Wanted,
    video: Video,
    requests: Mapping[str, FeatureRequest],
    size: Size,
    layers: tuple[str, ...],
    times: torch.Tensor,
) -> Entries:
    made = {**video.made, **(wanted.made or {})}
    chosen = [requests[layer] for layer in layers]
    return wanted.store.begin(chosen, Origin(str(video.path), size, times, made))


def _chunks(video: Video) -> Iterator[torch.Tensor]:
    """Blocks of frames; of a clip that is decoded as it goes, by a thread that is ahead."""
    blocks = pictures(video.frames)
    return blocks if video.frames.held else prefetched(blocks)


@dataclass(frozen=True)
class Cost:
    """What an extraction will take, measured by one pass.

    Args:
        seconds: of the network, for each frame.
        bytes: of the store, for each frame.
    """

    seconds: float
    bytes: float


def cost_of(wanted: Wanted, size: tuple[int, int]) -> Cost:
    """Seconds and bytes for a frame of this size, by a pass over a blank clip.

    Args:
        wanted: see :class:`Wanted`.
        size: of the frames, (height, width).
    """
    encoder: Any = wanted.encoder
    windowing = getattr(encoder, "windowing", None)
    each = encoder.frame_stride * windowing.frames if windowing else 8
    count = each * getattr(encoder, "batch", 1)
    blank = torch.zeros(1, count, 3, *size, dtype=torch.uint8)
    times = torch.arange(count, dtype=torch.float64)
    begun = time.perf_counter()
    found = encoder.encode_layers(blank, times, wanted.layers)
    seconds = time.perf_counter() - begun
    kept = 0
    for features in found.values():
        sides = (min(side, wanted.grid or side) for side in features.grid)
        kept += bytes_kept((*features.values.shape[:-2], *sides), wanted.dtype)
    return Cost(seconds / count, kept / count)
