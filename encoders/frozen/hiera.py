"""SAM 2's image trunk, Hiera-Tiny (Ravi et al., arXiv:2408.00714), frame by frame, frozen.

One frame is enough; each frame is seen alone, so that any number of frames has as many feature
frames, at the frames' own times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.base import Dtype, FrozenEncoder
from encoders.frozen.runtimes import Runtime
from encoders.frozen.windows import Windowing
from encoders.identity import EncoderIdentity
from encoders.preprocess import imagenet_clips, network_size
from encoders.release import WeightsFile, load_strict
from encoders.weights import find_weights

NAME = "hiera"
MODEL = "sam2_hiera_tiny.fb_r896"
CODE_VERSION = 1
MULTIPLE = 32
PREPROCESSING = "rgb, longer side to resolution, sides to multiples of 32, bilinear, imagenet"
LAYERS = {4: 0, 8: 1, 16: 2, 32: 3}


@dataclass(frozen=True)
class HieraSettings:
    """What is read, and at which cost.

    Args:
        layer: the stage, named by its stride in network pixels: 4, 8, 16 or 32 (96, 192, 384,
            768 channels). Later stages are not computed. Stride 8 localises best for its price.
        resolution: network pixels of the longer image side, a multiple of 32.
        dtype: of the computation.
        batch: frames per forward pass. The last pass is filled up, so that a frame has the same
            features whatever it is encoded together with.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: Literal[4, 8, 16, 32] = 8
    resolution: int = 128
    dtype: Dtype = "float32"
    batch: int = 8
    runtime: Runtime = "torch"


class HieraEncoder(FrozenEncoder):
    """Frames to feature maps of one stage.

    Args:
        trunk: the timm model.
        settings: see :class:`HieraSettings`.
        weights: the file that the trunk was loaded from.

    Raises:
        ValueError: a stage or a resolution that the trunk does not have.
    """

    def __init__(self, trunk: nn.Module, settings: HieraSettings, weights: WeightsFile) -> None:
        network_size(1, 1, settings.resolution, MULTIPLE)
        if settings.layer not in LAYERS:
            raise ValueError(f"hiera: no layer {settings.layer!r}; it has 4, 8, 16 and 32")
        self.settings = settings
        identity = EncoderIdentity(
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=PREPROCESSING,
            layer=str(settings.layer),
            resolution=settings.resolution,
            dtype=settings.dtype,
        )
        super().__init__(trunk, Windowing(), 1, settings.batch, identity, settings.runtime)

    def encode(self, clips: Float[Tensor, "n f c H W"]) -> Float[Tensor, "n t k h w"]:
        height, width = clips.shape[-2:]
        size = network_size(height, width, self.settings.resolution, MULTIPLE)
        pixels = imagenet_clips(clips, size, self.dtype)
        return self.fast_maps(pixels.flatten(0, 1)).unflatten(0, clips.shape[:2])

    def maps(self, pixels: Tensor) -> Tensor:
        """``(f, 3, h, w)`` to ``(f, k, h, w)``."""
        forward = cast(Callable[..., list[Tensor]], self.network.forward_intermediates)
        (maps,) = forward(
            pixels,
            indices=[LAYERS[self.settings.layer]],
            intermediates_only=True,
            stop_early=True,
            output_fmt="NCHW",
        )
        return maps


def build_trunk() -> nn.Module:
    """The network with fresh weights (27 M parameters)."""
    import timm

    return timm.create_model(MODEL, pretrained=False, num_classes=0)


def load_hiera(
    settings: HieraSettings, where: Path | None = None, device: str = "cpu"
) -> HieraEncoder:
    """The frozen encoder from its weights on disk, strictly.

    Args:
        settings: see :class:`HieraSettings`.
        where: file or folder; ``VIDPHYS_WEIGHTS`` or the user's cache where not given.
        device: where the network runs and the features are left.

    Raises:
        WeightsMissing: the file is not there.
        ValueError: the file is not the expected one.
    """
    weights = find_weights(NAME, where)
    trunk = build_trunk()
    load_strict(trunk, weights.path, unused=("head.",))
    return HieraEncoder(trunk.to(device), settings, weights)
