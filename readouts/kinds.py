"""Kinds of readouts by name: how one is made for a feature map, and how its training is sized."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from readouts.attention import AttentionReadout
from readouts.base import FrameReadout
from readouts.local import RefinedReadout
from readouts.pooled import PooledReadout
from registry import Registry


@dataclass(frozen=True)
class MapShape:
    """The feature frames that a readout is made for.

    Args:
        channels: of the features.
        grid: cells (height, width).
        bodies: in a frame of the clip.
        frames: of the clip that one feature frame stands for.
    """

    channels: int
    grid: tuple[int, int]
    bodies: int
    frames: int = 1

    @property
    def positions(self) -> int:
        """That a readout gives for a feature frame."""
        return self.frames * self.bodies


@dataclass(frozen=True)
class ReadoutKind:
    """One kind of readout.

    Args:
        make: from a :class:`MapShape` and, by name, each of the sizes.
        sizes: what it can be made in several sizes of, with the defaults.
        steps: of its optimiser.
        batch: feature frames a step.
        clip: largest gradient norm; 0 clips nothing.
        shift: cells by which its training maps are moved at random, so that few frames show more
            places; ``None`` where that would teach it nothing.
    """

    make: Callable[..., FrameReadout]
    sizes: Mapping[str, int] = field(default_factory=dict)
    steps: int = 1200
    batch: int = 16
    clip: float = 0.0
    shift: int | None = 4


READOUTS: Registry[ReadoutKind] = Registry("readout", "vidphys.readouts")


@dataclass(frozen=True)
class Recipe:
    """All that a readout's weights fit.

    Args:
        kind: its name in :data:`READOUTS`.
        shape: what it reads.
        sizes: of the kind.

    Example:
        >>> shape = MapShape(channels=8, grid=(6, 6), bodies=2)
        >>> Recipe("attention", shape, {"width": 16}).build().query.shape
        torch.Size([2, 16])
    """

    kind: str
    shape: MapShape
    sizes: Mapping[str, int]

    def build(self) -> FrameReadout:
        """An untrained one.

        Raises:
            ValueError: an unknown kind, or sizes that it cannot have.
        """
        return READOUTS[self.kind].make(self.shape, **self.sizes)


def _attention(shape: MapShape, width: int) -> FrameReadout:
    return AttentionReadout(shape.channels, shape.positions, width, frames=shape.frames)


def _refined(shape: MapShape, readers: int) -> FrameReadout:
    return RefinedReadout(shape.channels, shape.positions, shape.grid, shape.frames, readers)


def _pooled(shape: MapShape, width: int) -> FrameReadout:
    return PooledReadout(shape.channels, shape.positions, width)


READOUTS.register("refined", ReadoutKind(_refined, {"readers": 3}, 5400, 128, 1.0))
READOUTS.register("attention", ReadoutKind(_attention, {"width": 128}))
READOUTS.register("pooled", ReadoutKind(_pooled, {"width": 128}, shift=None))
