"""Any encoder as what gives the maps of all its layers: one of ours, or whatever can be called."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from encoders.features import FeatureMap
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.untrained import drawn_anew, untrained
from encoders.identity import LayeredEncoder

Maps = dict[str, Tensor]  # by layer, in order of depth: (b, t, c, h, w)


class AllLayers(Protocol):
    """Frames to the maps of all layers."""

    @property
    def alone(self) -> bool:
        """Whether each frame is seen alone, so that no other one changes its features."""
        ...

    def __call__(self, frames: Tensor, times: Tensor) -> Maps:
        """Of clips ``(b, t, c, H, W)`` whose frames are at ``times`` (seconds), ``(t,)``."""
        ...


@dataclass(frozen=True)
class Own(AllLayers):
    """Somebody's encoder.

    Args:
        call: takes frames ``(b, t, 3, H, W)`` in [0, 1]; gives the features of one layer, or a
            mapping of layers by name in order of depth. A layer is a :class:`FeatureMap`, or a
            tensor ``(b, t, c, h, w)``, ``(b, t, c)`` (one for each frame or tubelet) or ``(b, c)``.
    """

    call: Callable[[Tensor], Any]
    alone = False

    def __call__(self, frames: Tensor, times: Tensor) -> Maps:
        seen = frames.float() if frames.is_floating_point() else frames.float() / 255
        with torch.no_grad():
            found = self.call(seen)
        layers = found if isinstance(found, Mapping) else {"output": found}
        return {str(name): _as_map(name, layer, frames) for name, layer in layers.items()}


@dataclass(frozen=True)
class Frozen(AllLayers):
    """A frozen encoder, several layers from one pass.

    Args:
        encoder: see there.
        layers: of it, in order of depth.
    """

    encoder: LayeredEncoder
    layers: tuple[str, ...]

    @property
    def alone(self) -> bool:
        encoder = self.encoder
        if not isinstance(encoder, FrozenEncoder):
            return False
        return encoder.windowing.frames == 1 and encoder.frame_stride == 1

    def __call__(self, frames: Tensor, times: Tensor) -> Maps:
        found = self.encoder.encode_layers(frames, times, self.layers)
        return {layer: features.values for layer, features in found.items()}


def all_layers(encoder: Any) -> AllLayers:
    """What gives the maps of all layers of ``encoder``.

    Raises:
        ValueError: it cannot be called.
    """
    if isinstance(encoder, LayeredEncoder):
        return Frozen(encoder, encoder.layers)
    if callable(encoder):
        return Own(encoder)
    raise ValueError(
        f"probe: `encoder` must be callable on frames (b, t, 3, H, W), got {type(encoder).__name__}"
    )


def untrained_of(encoder: Any, given: Any, seed: int) -> AllLayers | None:
    """The same encoder before any training, or ``None`` where it cannot be had.

    Args:
        encoder: see :func:`all_layers`.
        given: somebody's own untrained one, which is taken where there is one.
        seed: of the random weights.
    """
    if given is not None:
        return all_layers(given)
    if isinstance(encoder, FrozenEncoder):
        return all_layers(untrained(copy.deepcopy(encoder), seed))
    if isinstance(encoder, nn.Module):
        return all_layers(drawn_anew(copy.deepcopy(encoder), seed))
    return None


def _as_map(name: object, layer: Any, frames: Tensor) -> Tensor:
    values = layer.values if isinstance(layer, FeatureMap) else layer
    if isinstance(values, Tensor) and values.ndim in (2, 3, 5) and len(values) == len(frames):
        if values.ndim == 2:
            values = values[:, None]
        return values if values.ndim == 5 else values[..., None, None]
    what = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
    raise ValueError(
        f"probe: layer {name}: {len(frames)} clips must give features ({len(frames)}, t, c, h, w), "
        f"({len(frames)}, t, c) or ({len(frames)}, c), got {what}"
    )
