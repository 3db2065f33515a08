"""SAM 2's image trunk, Hiera-Tiny (Ravi et al., arXiv:2408.00714), frame by frame, frozen.

One frame is enough; each frame is seen alone, so that any number of frames has as many feature
frames, at the frames' own times.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from torch import nn

from encoders.frozen.base import Dtype
from encoders.frozen.runtimes import Runtime
from encoders.frozen.timm_maps import TimmMaps
from encoders.frozen.tokens import chosen_layer
from encoders.frozen.untrained import fresh
from encoders.preprocess import Fitting
from encoders.release import WeightsFile, load_strict
from encoders.weights import find_weights

NAME = "hiera"
MODEL = "sam2_hiera_tiny.fb_r896"
CODE_VERSION = 1
MULTIPLE = 32
PREPROCESSING = "rgb, longer side to resolution, sides to multiples of 32, bilinear, imagenet"
LAYERS = ("4", "8", "16", "32")


@dataclass(frozen=True)
class HieraSettings:
    """What is read, and at which cost.

    Args:
        layer: the stage, named by its stride in network pixels: 4, 8, 16 or 32 (96, 192, 384,
            768 channels). Later stages are not computed. Stride 8 localises best for its price.
        resolution: network pixels of the longer image side, a multiple of 32.
        difference: frames to either side over which the change of the features is read beside
            them, see :mod:`encoders.frozen.differenced`; not read where not given.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: frames per forward pass. The last pass is filled up, so that a frame has the same
            features whatever it is encoded together with.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str = 8
    resolution: int = 128
    difference: int | None = None
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 8
    runtime: Runtime = "torch"


class HieraEncoder(TimmMaps):
    """Frames to feature maps of one stage.

    Args:
        trunk: the timm model.
        settings: see :class:`HieraSettings`.
        weights: the file that the trunk was loaded from.

    Raises:
        ValueError: a stage or a resolution that the trunk does not have.
    """

    def __init__(self, trunk: nn.Module, settings: HieraSettings, weights: WeightsFile) -> None:
        super().__init__(
            trunk,
            settings,
            Fitting("keep", settings.resolution, MULTIPLE),
            layers=LAYERS,
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=PREPROCESSING,
            layer=chosen_layer(NAME, settings.layer, LAYERS),
        )


def build_trunk() -> nn.Module:
    """The network with fresh weights (27 M parameters)."""
    import timm

    return timm.create_model(MODEL, pretrained=False, num_classes=0)


def load_hiera(
    settings: HieraSettings, where: Path | None = None, device: str = "cpu"
) -> HieraEncoder:
    """The frozen encoder from its weights on disk, strictly (see ``load_encoder``)."""
    if settings.seed is not None:
        trunk, weights = fresh(build_trunk, settings.seed)
    else:
        trunk, weights = build_trunk(), find_weights(NAME, where)
        load_strict(trunk, weights.path, unused=("head.",))
    return HieraEncoder(trunk.to(device), settings, weights)
