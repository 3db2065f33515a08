"""Which frames of a clip a network with a fixed number of frames sees, window by window.

A clip that is longer than a window is seen in several: one every ``hop`` frames, and a last one
that ends with the clip, so that no window is filled with copies. Where windows overlap, a feature
frame is taken from the window in which it is the most central (the earlier of two). A clip whose
number of frames is no multiple of the tubelet, or that is too short for a network that takes one
number of frames only, is filled up with copies of its last frame; feature frames that saw nothing
but copies are dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import torch
from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Windowing:
    """How a network samples time; all counts are in the frames that it is given.

    Args:
        frames: in a window, at most; a multiple of the tubelet.
        hop: from a window's start to the next one's; windows lie side by side where not given.
        tubelet: frames from a feature frame to the next one.
        centre: frame of the window that its first feature frame is centred on; the middle of the
            tubelet where not given.
        shortens: whether a shorter clip makes a shorter window, in place of copies.

    Raises:
        ValueError: counts that do not fit each other.
    """

    frames: int = 1
    hop: int | None = None
    tubelet: int = 1
    centre: float | None = None
    shortens: bool = False

    def __post_init__(self) -> None:
        if self.frames < 1 or self.frames % self.tubelet:
            raise ValueError(
                f"encoder: windows of {self.frames} frames do not fit tubelets of {self.tubelet}; "
                f"the nearest is {max(1, round(self.frames / self.tubelet)) * self.tubelet}"
            )
        if not 0 < self.step <= self.frames or self.step % self.tubelet:
            raise ValueError(
                f"encoder: hop {self.step} must be a multiple of {self.tubelet}, {self.tubelet} "
                f"to {self.frames} frames"
            )

    @property
    def step(self) -> int:
        """Frames from a window's start to the next one's."""
        return self.frames if self.hop is None else self.hop


@dataclass(frozen=True)
class Window:
    """One pass of the network: the clip's frames that it sees, and its feature frames kept."""

    frames: tuple[int, ...]
    kept: tuple[int, ...]

    @property
    def span(self) -> slice:
        """What is kept, as a slice: a card would wait for a list of places."""
        return slice(self.kept[0], self.kept[-1] + 1)


def windows(count: int, windowing: Windowing) -> list[Window]:
    """The windows of a clip of ``count`` frames; their kept feature frames follow each other."""
    tubelet = windowing.tubelet
    features = -(-count // tubelet)
    whole = features * tubelet
    length = min(whole, windowing.frames) if windowing.shortens else windowing.frames
    last = max(whole - length, 0)
    starts = [*range(0, last, windowing.step), last]
    middles = [start + (length - tubelet) / 2 for start in starts]
    kept: list[list[int]] = [[] for _ in starts]
    for feature in range(features):
        inside = [k for k, s in enumerate(starts) if s <= feature * tubelet < s + length]
        best = min(inside, key=lambda k: abs(feature * tubelet - middles[k]))
        kept[best].append(feature - starts[best] // tubelet)
    return [
        Window(tuple(min(start + i, count - 1) for i in range(length)), tuple(keep))
        for start, keep in zip(starts, kept, strict=True)
        if keep
    ]


def seen_by(plan: Sequence[Window], chunks: Iterable[Tensor], stride: int = 1) -> Iterator[Tensor]:
    """The frames ``(f, c, H, W)`` of each window of a clip whose frames come in chunks.

    Args:
        plan: windows in order, as :func:`windows` makes them.
        chunks: of the clip's frames, ``(n, c, H, W)``.
        stride: of the clip's frames, of which the windows count each so-many-th.

    Raises:
        ValueError: fewer frames come in than the windows see.
    """
    coming = (frame for chunk in chunks for frame in chunk)
    taken, held, count = islice(coming, 0, None, stride), dict[int, Tensor](), 0
    for window in plan:
        first, last = window.frames[0], window.frames[-1]
        held = {number: frame for number, frame in held.items() if number >= first}
        for frame in islice(taken, last + 1 - count):
            held[count] = frame
            count += 1
        if count <= last:
            raise ValueError(f"encoder: {count} frames came in, more than {last} were announced")
        yield torch.stack([held[frame] for frame in window.frames])


def feature_times(times: Float[Tensor, " t"], windowing: Windowing) -> Float[Tensor, " f"]:
    """Seconds of each feature frame's centre; the copies that fill a clip up are its last frame."""
    tubelet, last = windowing.tubelet, len(times) - 1
    first = (tubelet - 1) / 2 if windowing.centre is None else windowing.centre
    centres = torch.arange(-(-len(times) // tubelet), device=times.device) * tubelet + first
    centres = centres.to(times.dtype).clamp(0, last)
    below = centres.floor().long()
    above = (below + 1).clamp_max(last)
    return times[below] + (centres - below) * (times[above] - times[below])
