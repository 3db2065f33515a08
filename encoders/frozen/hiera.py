"""SAM 2's image trunk, Hiera-Tiny (Ravi et al., arXiv:2408.00714), frame by frame, frozen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.preprocess import network_size, normalise, resize, to_rgb
from encoders.weights import WeightsFile, find_weights, load_strict

NAME = "hiera"
MODEL = "sam2_hiera_tiny.fb_r896"
CODE_VERSION = 1
MULTIPLE = 32
PREPROCESSING = "rgb, longer side to resolution, sides to multiples of 32, bilinear, imagenet"
LAYERS = {4: 0, 8: 1, 16: 2, 32: 3}
DTYPES = {"float32": torch.float32, "bfloat16": torch.bfloat16, "float16": torch.float16}


@dataclass(frozen=True)
class HieraSettings:
    """What is read, and at which cost.

    Args:
        layer: the stage, named by its stride in network pixels: 4, 8, 16 or 32 (96, 192, 384,
            768 channels). Later stages are not computed. Stride 8 localises best for its price
            (inventory 14.5).
        resolution: network pixels of the longer image side, a multiple of 32.
        dtype: of the computation.
        batch: frames per forward pass. The last pass is filled up, so that a frame has the same
            features whatever it is encoded together with.
    """

    layer: Literal[4, 8, 16, 32] = 8
    resolution: int = 128
    dtype: Literal["float32", "bfloat16", "float16"] = "float32"
    batch: int = 8


class HieraEncoder:
    """Frames to feature maps. One frame is enough; each frame is seen alone.

    Args:
        trunk: the timm model; frozen and put into evaluation mode here.
        settings: see :class:`HieraSettings`.
        weights: the file that the trunk was loaded from.
    """

    def __init__(self, trunk: nn.Module, settings: HieraSettings, weights: WeightsFile) -> None:
        network_size(1, 1, settings.resolution, MULTIPLE)
        self.settings = settings
        self.trunk = trunk.to(DTYPES[settings.dtype]).eval().requires_grad_(False)
        self.identity = EncoderIdentity(
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=PREPROCESSING,
            layer=str(settings.layer),
            resolution=settings.resolution,
            dtype=settings.dtype,
        )

    def __call__(
        self, frames: Float[Tensor, "b t c H W"], times: Float[Tensor, " t"]
    ) -> FeatureMap:
        """Encode frames with values in [0, 1], taken at ``times`` (seconds).

        Returns:
            A map whose stride is in pixels of ``frames``, so that its cell centres are those of
            the given image even where the resizing changed the aspect ratio a little.

        Raises:
            ValueError: no frames, or values that are not finite.
        """
        b, t, _, height, width = frames.shape
        if b * t == 0:
            raise ValueError(f"hiera: needs at least one frame, got shape {tuple(frames.shape)}")
        if not bool(torch.isfinite(frames).all()):
            raise ValueError("hiera: frames must be finite; a pixel is NaN or infinite")
        size = network_size(height, width, self.settings.resolution, MULTIPLE)
        flat = frames.flatten(0, 1)
        with torch.inference_mode():
            values = torch.cat([self._encode(part, size) for part in flat.split(self._batch)])
        # leaving inference mode by a copy lets readouts be trained on the features
        values = values.clone().unflatten(0, (b, t))
        h, w = values.shape[-2:]
        return FeatureMap(values, (height / h, width / w), times)

    @property
    def _batch(self) -> int:
        return self.settings.batch

    def _encode(self, frames: Tensor, size: tuple[int, int]) -> Tensor:
        count = len(frames)
        if count < self._batch:
            frames = torch.cat([frames, frames[-1:].expand(self._batch - count, -1, -1, -1)])
        weight = next(self.trunk.parameters())
        pixels = normalise(resize(to_rgb(frames.to(weight.device).float()), size))
        forward = cast(Callable[..., list[Tensor]], self.trunk.forward_intermediates)
        maps = forward(
            pixels.to(weight.dtype),
            indices=[LAYERS[self.settings.layer]],
            intermediates_only=True,
            stop_early=True,
            output_fmt="NCHW",
        )
        return maps[0][:count].float()


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
