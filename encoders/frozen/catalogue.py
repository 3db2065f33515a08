"""The frozen encoders by name, as the command line and experiments ask for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.dinov2 import ARCHITECTURES, DINOTinySettings, DINOv2Settings, load_dinov2
from encoders.frozen.hiera import HieraSettings, load_hiera
from encoders.frozen.i3d import I3DSettings, load_i3d
from encoders.frozen.videomae import VideoMAESettings, load_videomae
from encoders.frozen.vjepa2 import VJEPA2Settings, VJEPA2TinySettings, load_vjepa2
from encoders.frozen.vjepa2_ac import VJEPA2ACSettings, load_vjepa2_ac


@dataclass(frozen=True)
class Adapter:
    """What an encoder is set by, and what loads it from settings, place of weights and device."""

    settings: type[Any]
    load: Callable[[Any, Path | None, str], FrozenEncoder]


CATALOGUE = {
    "hiera": Adapter(HieraSettings, load_hiera),
    "i3d": Adapter(I3DSettings, load_i3d),
    **{name: Adapter(DINOv2Settings, partial(load_dinov2, name)) for name in ARCHITECTURES},
    "dino-tiny": Adapter(DINOTinySettings, partial(load_dinov2, "dino-tiny")),
    "videomae-tiny": Adapter(VideoMAESettings, partial(load_videomae, "videomae-tiny")),
    "vjepa2-tiny": Adapter(VJEPA2TinySettings, partial(load_vjepa2, "vjepa2-tiny")),
    "videomae-small": Adapter(VideoMAESettings, partial(load_videomae, "videomae-small")),
    "videomae-base": Adapter(VideoMAESettings, partial(load_videomae, "videomae-base")),
    "vjepa2-l": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-l")),
    "vjepa2-h": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-h")),
    "vjepa2-g": Adapter(VJEPA2Settings, partial(load_vjepa2, "vjepa2-g")),
    "vjepa2-ac": Adapter(VJEPA2ACSettings, load_vjepa2_ac),
}


def load_encoder(
    name: str, options: dict[str, Any], where: Path | None = None, device: str = "cpu"
) -> FrozenEncoder:
    """The encoder ``name``.

    Args:
        name: a key of ``CATALOGUE``.
        options: fields of the encoder's settings; those that are ``None`` keep their default.
        where: where its weights lie; see :func:`encoders.weights.find_weights`.
        device: where the network runs and the features are left.

    Raises:
        ValueError: unknown name or option, an option's value that the encoder does not take, or
            weights that are missing or wrong.
    """
    if name not in CATALOGUE:
        raise ValueError(f"encoder: unknown name {name!r}; known are {', '.join(CATALOGUE)}")
    adapter = CATALOGUE[name]
    given = {key: value for key, value in options.items() if value is not None}
    taken = [field.name for field in fields(adapter.settings)]
    for key in given:
        if key not in taken:
            raise ValueError(f"{name}: takes no {key}; it takes {', '.join(taken)}")
    return adapter.load(adapter.settings(**given), where, device)
