"""The frozen encoders by name, as the command line and experiments ask for them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from encoders.frozen.adapter import WHERE, Adapter
from encoders.frozen.any_hub import AnyHubSettings, any_hub, load_any_hub
from encoders.frozen.any_timm import AnyTimmSettings, any_timm, load_any_timm
from encoders.frozen.any_torchvision import (
    TorchvisionSettings,
    any_torchvision,
    load_any_torchvision,
)
from encoders.frozen.base import FrozenEncoder
from encoders.frozen.dinov2 import ARCHITECTURES, DINOTinySettings, DINOv2Settings, load_dinov2
from encoders.frozen.foreign import as_ours
from encoders.frozen.hiera import HieraSettings, load_hiera
from encoders.frozen.i3d import I3DSettings, load_i3d
from encoders.frozen.sam2_memory import Sam2MemorySettings, load_sam2_memory
from encoders.frozen.videomae import VideoMAESettings, load_videomae
from encoders.frozen.vjepa2 import VJEPA2Settings, VJEPA2TinySettings, load_vjepa2
from encoders.frozen.vjepa2_ac import VJEPA2ACSettings, load_vjepa2_ac
from encoders.identity import LayeredEncoder
from encoders.known_weights import KNOWN
from registry import Registry

# A factory takes its encoder's options by name, and ``weights`` (a path) and ``device`` if it has a
# use for them; it returns a FrozenEncoder, or anything that is called like an Encoder.
DOORS: dict[str, Callable[[str], Callable[..., Any]]] = {
    "timm": any_timm,
    "hf": any_hub,
    "torchvision": any_torchvision,
}
ENCODERS: Registry[Callable[..., Any]] = Registry("encoder", "vidphys.encoders", DOORS)
Loader = Callable[..., FrozenEncoder]
TINY: dict[str, tuple[type[Any], Loader]] = {  # our own, by their kind
    "dino": (DINOTinySettings, load_dinov2),
    "videomae": (VideoMAESettings, load_videomae),
    "vjepa2": (VJEPA2TinySettings, load_vjepa2),
}
TWINS = ("", "-attraction")  # of each, the second of which never saw repulsion

for _name, _factory in {
    "hiera": Adapter(HieraSettings, load_hiera),
    "i3d": Adapter(I3DSettings, load_i3d),
    "sam2-memory": Adapter(Sam2MemorySettings, load_sam2_memory),
    **{name: Adapter(DINOv2Settings, partial(load_dinov2, name)) for name in ARCHITECTURES},
    **{
        name: Adapter(taken, partial(load, name))
        for kind, (taken, load) in TINY.items()
        for name in (f"{kind}-tiny{twin}" for twin in TWINS)
    },
    "videomae-small": Adapter(VideoMAESettings, partial(load_videomae, "videomae-small")),
    "videomae-base": Adapter(VideoMAESettings, partial(load_videomae, "videomae-base")),
    "vjepa2-l": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-l")),
    "vjepa2-h": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-h")),
    "vjepa2-g": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-g")),
    "vjepa2-ac": Adapter(VJEPA2ACSettings, load_vjepa2_ac),
}.items():
    ENCODERS.register(_name, _factory)

# names of ours for what is behind a door; what is special about each stands in the table of weights
OPENED: dict[str, tuple[type[Any], Callable[..., FrozenEncoder]]] = {
    "timm": (AnyTimmSettings, load_any_timm),
    "hf": (AnyHubSettings, load_any_hub),
    "torchvision": (TorchvisionSettings, load_any_torchvision),
}
for _name, _known in KNOWN.items():
    if _known.door is not None:
        _door, _, _inner = _known.door.partition(":")
        _settings, _load = OPENED[_door]
        ENCODERS.register(_name, Adapter(_settings, partial(_load, _inner or _known.hub, _name)))


def options_of(name: str) -> tuple[str, ...]:
    """Names of the options that an encoder takes."""
    return tuple(inspect.signature(ENCODERS[name]).parameters)


def load_encoder(
    name: str, options: dict[str, Any], where: Path | None = None, device: str = "cpu"
) -> LayeredEncoder:
    """The encoder ``name``.

    Args:
        name: of ``ENCODERS``.
        options: of the encoder; those that are ``None`` keep their default.
        where: where its weights lie; see :func:`encoders.weights.find_weights`.
        device: where the network runs and the features are left.

    Raises:
        ValueError: unknown name or option, an option's value that the encoder does not take, or
            weights that are missing or wrong.

    Example:
        >>> import torch
        >>> encoder = load_encoder("dino-tiny", {})
        >>> clip = torch.zeros(1, 2, 3, 64, 64, dtype=torch.uint8)
        >>> features = encoder(clip, torch.tensor([0.0, 0.1]))
        >>> tuple(features.values.shape), features.stride
        ((1, 2, 96, 16, 16), (4.0, 4.0))
    """
    factory, taken = ENCODERS[name], options_of(name)
    told = {"weights": where, "device": None if device == "cpu" else device}
    given = {key: value for key, value in (options | told).items() if value is not None}
    for key in given:
        if key not in taken:
            known = ", ".join(option for option in taken if option not in WHERE)
            raise ValueError(f"{name}: takes no {key}; it takes {known or 'nothing'}")
    source, made = ENCODERS.source(name), factory(**given)
    return made if source.ours else as_ours(made, name, str(source), given)
