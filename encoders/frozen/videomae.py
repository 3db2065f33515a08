"""VideoMAE video transformers (Tong et al., arXiv:2203.12602), frozen.

Weights are the release folders of ``transformers`` (small, base), or our own tiny one: of the
encoder alone, or with the decoder or the classifier that it was trained with, which are left out.
The position table fixes the input: 16 frames of 224 x 224 pixels, tubelets of 2 frames and 16 x 16
pixels (tiny: 4 frames of 64 x 64, tubelets of 2 and 4 x 4); the whole image is resized to the
square.

Any number of frames is taken. One frame, or fewer than a window has, are followed by copies of the
last one; an odd number by one copy; feature frames that saw only copies are dropped. A long clip is
seen in windows, side by side unless ``hop`` is less, and a last one that ends with the clip. A
feature frame's time is the middle of the two frames that its tubelet covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.base import Dtype, FrozenEncoder
from encoders.frozen.runtimes import Runtime
from encoders.frozen.tokens import chosen_layer, numbered, token_maps, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.preprocess import imagenet_clips
from encoders.release import WeightsFile, load_strict, read_config
from encoders.weights import config_of, find_weights

CODE_VERSION = 1
NAMES = ("videomae-tiny", "videomae-tiny-attraction", "videomae-small", "videomae-base")
PREPROCESSING = "rgb, the image to the square, bilinear, imagenet"
SMALL = {"hidden_size": 384, "num_attention_heads": 6, "intermediate_size": 1536}
UNUSED = (
    "decoder.",
    "encoder_to_decoder.",
    "mask_token",
    "position_embeddings",
    "classifier.",
    "fc_norm.",
)


@dataclass(frozen=True)
class VideoMAESettings:
    """What is read, and at which cost.

    Args:
        layer: blocks that are run, from 1; all where not given, and then the final norm too, where
            the release has one. Later blocks are not computed.
        hop: frames from a window's start to the next one's; the window's own where not given.
        frame_stride: take each so-many-th frame, before windows are made.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per forward pass.
        runtime: what computes the network; see :mod:`encoders.frozen.runtimes`.
    """

    layer: int | str | None = None
    hop: int | None = None
    frame_stride: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1
    runtime: Runtime = "torch"


class VideoMAEEncoder(FrozenEncoder):
    """Windows of frames to maps of tubelet tokens.

    Args:
        network: the ``VideoMAEModel``.
        settings: see :class:`VideoMAESettings`.
        name: one of ``NAMES``.
        weights: what the network was loaded from.

    Raises:
        ValueError: a layer or a hop that the network does not have.
    """

    def __init__(
        self, network: nn.Module, settings: VideoMAESettings, name: str, weights: WeightsFile
    ) -> None:
        config: Any = network.config
        self.config = config
        layers = numbered(config.num_hidden_layers)
        windowing = Windowing(config.num_frames, settings.hop, config.tubelet_size)
        words = windowing_words(windowing, settings.frame_stride)
        super().__init__(
            network,
            settings,
            windowing,
            layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, {PREPROCESSING}",
            layer=chosen_layer(name, settings.layer, layers),
            resolution=config.image_size,
        )

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> Sequence[Float[Tensor, "n t k h w"]]:
        side = self.config.image_size
        return self.fast_maps(imagenet_clips(clips, (side, side), self.dtype), layers)

    def maps(self, pixels: Tensor, layers: tuple[str, ...]) -> list[Tensor]:
        """``(n, f, 3, h, w)`` to ``(n, t, k, h, w)`` of each layer."""
        network: Any = self.network
        tokens = network.embeddings(pixels, None)
        found: list[Tensor] = []
        for layer, block in zip(self.layers, network.encoder.layer, strict=True):
            tokens = block(tokens)
            if layer in layers:
                found.append(tokens)
            if layer == layers[-1]:
                break
        if layers[-1] == self.layers[-1] and network.layernorm is not None:
            found[-1] = network.layernorm(tokens)
        grid = self.config.image_size // self.config.patch_size
        frames = pixels.shape[1] // self.config.tubelet_size
        return [token_maps(tokens, frames, grid, grid) for tokens in found]


def load_videomae(
    name: str, settings: VideoMAESettings, where: Path | None = None, device: str = "cpu"
) -> VideoMAEEncoder:
    """The frozen encoder from its release folder, strictly (see ``load_encoder``)."""
    from transformers import VideoMAEConfig, VideoMAEModel

    def build() -> nn.Module:
        return VideoMAEModel(VideoMAEConfig.from_dict(config))

    told = {"model_type": "videomae"}
    if settings.seed is not None:
        config = config_of(name, where, told, SMALL if name == "videomae-small" else {})
        network, weights = fresh(build, settings.seed)
    else:
        weights = find_weights(name, where)
        config = read_config(weights.path, told)
        network = build()
        load_strict(network, weights.path, UNUSED, _renamed)
    return VideoMAEEncoder(network.to(device), settings, name, weights)


def _renamed(key: str) -> str:
    """The release's key as the present library has it: without a prefix, with biases in layers."""
    key = key.removeprefix("videomae.")
    return key.replace(".q_bias", ".query.bias").replace(".v_bias", ".value.bias")
