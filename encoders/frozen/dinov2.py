"""DINOv2 image transformers (Oquab et al., arXiv:2304.07193), frame by frame, frozen.

Weights are the release folders of ``timm`` (small, base, large; patches of 14 pixels), or our own
tiny one (patches of 4 pixels). One frame is enough; each frame is seen alone, so that any number of
frames, odd or long, has as many feature frames, at the frames' own times. The position table is
interpolated to the grid that is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from torch import nn

from encoders.frozen.base import Dtype
from encoders.frozen.runtimes import Runtime
from encoders.frozen.timm_maps import TimmMaps
from encoders.frozen.tokens import chosen_layer, numbered
from encoders.frozen.untrained import fresh
from encoders.preprocess import Fitting
from encoders.release import WeightsFile, load_strict, read_config
from encoders.weights import config_of, find_weights

CODE_VERSION = 1
ARCHITECTURES = {
    f"dinov2-{size}": f"vit_{size}_patch14_dinov2" for size in ("small", "base", "large")
} | dict.fromkeys(("dino-tiny", "dino-tiny-attraction"), "vit_small_patch14_dinov2")


@dataclass(frozen=True)
class DINOv2Settings:
    """What is read, and at which cost.

    Args:
        layer: blocks that are run, from 1; all where not given, and then the final norm too. Later
            blocks are not computed.
        resolution: network pixels of the longer image side, a multiple of the patch.
        frame_stride: take each so-many-th frame.
        difference: frames to either side over which the change of the features is read beside
            them, see :mod:`encoders.frozen.differenced`; not read where not given.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: frames per forward pass.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str | None = None
    resolution: int = 224
    frame_stride: int = 1
    difference: int | None = None
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 8
    runtime: Runtime = "torch"


@dataclass(frozen=True)
class DINOTinySettings(DINOv2Settings):
    """Those of our own tiny one, at the resolution that it was trained at."""

    resolution: int = 64


class DINOv2Encoder(TimmMaps):
    """Frames to maps of patch tokens.

    Args:
        network: the timm model, with positions for any image size.
        settings: see :class:`DINOv2Settings`.
        name: a key of ``ARCHITECTURES``.
        weights: what the network was loaded from.

    Raises:
        ValueError: a layer or a resolution that the network does not have.
    """

    def __init__(
        self, network: nn.Module, settings: DINOv2Settings, name: str, weights: WeightsFile
    ) -> None:
        patch: int = cast(Any, network).patch_embed.patch_size[0]
        depth = len(cast(nn.Sequential, network.blocks))
        layers = numbered(depth)
        super().__init__(
            network,
            settings,
            Fitting("keep", settings.resolution, patch),
            norm=True,
            layers=layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=(
                f"each {settings.frame_stride}. frame, rgb, longer side to resolution, "
                f"sides to multiples of {patch}, bilinear, imagenet"
            ),
            layer=chosen_layer(name, settings.layer, layers),
        )


def load_dinov2(
    name: str, settings: DINOv2Settings, where: Path | None = None, device: str = "cpu"
) -> DINOv2Encoder:
    """The frozen encoder from its release folder, strictly (see ``load_encoder``)."""
    import timm

    def build() -> nn.Module:
        arguments = {**config.get("model_args", {}), "num_classes": 0, "dynamic_img_size": True}
        return timm.create_model(ARCHITECTURES[name], pretrained=False, **arguments)

    told = {"architecture": ARCHITECTURES[name]}
    if settings.seed is not None:
        config = config_of(name, where, told, {})
        network, weights = fresh(build, settings.seed)
    else:
        weights = find_weights(name, where)
        config = read_config(weights.path, told)
        network = build()
        load_strict(network, weights.path)
    return DINOv2Encoder(network.to(device), settings, name, weights)
