"""V-JEPA 2 video transformers (Assran et al., arXiv:2506.09985), frozen.

Weights are the release folders of ``transformers`` (ViT-L, H, g), or our own tiny one. Positions
are rotary, so that any number of frames and any grid is taken: tubelets of 2 frames and 16 x 16
pixels (tiny: 4 x 4). The predictor is
loaded and run only where ``predictor`` asks for it; it then has all tokens for context and says all
of them, which is what the library's own forward pass returns.

One frame is repeated once; an odd number of frames is followed by a copy of the last one; a clip
shorter than a window makes a shorter window. A long clip is seen in windows of ``frames`` frames,
side by side unless ``hop`` is less, and a last one that ends with the clip. A feature frame's time
is the middle of the two frames that its tubelet covers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from encoders.frozen.base import DTYPES, Dtype, FrozenEncoder
from encoders.frozen.tokens import chosen_layer, numbered, token_maps, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.preprocess import imagenet_clips, network_size
from encoders.release import WeightsFile, load_strict, read_config
from encoders.weights import config_of, find_weights

CODE_VERSION = 1
LARGER: dict[str, dict[str, Any]] = {
    "vjepa2-h": {"hidden_size": 1280, "num_hidden_layers": 32},
    "vjepa2-g": {
        "hidden_size": 1408,
        "num_hidden_layers": 40,
        "num_attention_heads": 22,
        "mlp_ratio": 48 / 11,
    },
}  # than the library's own configuration, which is that of L
PREDICTOR = "predictor"  # a layer beyond the encoder's last
NAMES = ("vjepa2-tiny", "vjepa2-tiny-attraction", "vjepa2-l", "vjepa2-h", "vjepa2-g")
PREPROCESSING = "rgb, longer side to resolution, sides to whole patches, bilinear, imagenet"


@dataclass(frozen=True)
class VJEPA2Settings:
    """What is read, and at which cost.

    Args:
        layer: blocks that are run, from 1; all where not given, and then the final norm too. Later
            blocks are not computed.
        resolution: network pixels of the longer image side, a multiple of the patch.
        frames: in a window, a multiple of the tubelet (2).
        hop: frames from a window's start to the next one's; ``frames`` where not given.
        frame_stride: take each so-many-th frame, before windows are made.
        predictor: read the predictor's output in place of the encoder's.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per forward pass.
    """

    layer: int | str | None = None
    resolution: int = 256
    frames: int = 16
    hop: int | None = None
    frame_stride: int = 1
    predictor: bool = False
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1


@dataclass(frozen=True)
class VJEPA2TinySettings(VJEPA2Settings):
    """Those of our own tiny one, at the resolution and length that it was trained at."""

    resolution: int = 64
    frames: int = 4


class VJEPA2Encoder(FrozenEncoder):
    """Windows of frames to maps of tubelet tokens.

    Args:
        network: the ``VJEPA2Encoder`` of the library and, where asked for, its predictor, by the
            names ``encoder`` and ``predictor``.
        config: the library's configuration, made for ``settings.resolution``.
        settings: see :class:`VJEPA2Settings`.
        name: one of ``NAMES``.
        weights: what the network was loaded from.

    Raises:
        ValueError: a layer, a resolution or a window that the network does not have.
    """

    def __init__(
        self,
        network: nn.ModuleDict,
        config: Any,
        settings: VJEPA2Settings,
        name: str,
        weights: WeightsFile,
    ) -> None:
        network_size(1, 1, settings.resolution, config.patch_size)
        if settings.predictor and settings.layer is not None:
            raise ValueError(f"{name}: the predictor reads the last layer; leave out layer")
        self.config = config
        layers = numbered(config.num_hidden_layers)
        layer = chosen_layer(name, settings.layer, layers)
        tubelet = config.tubelet_size
        windowing = Windowing(settings.frames, settings.hop, tubelet, shortens=True)
        words = windowing_words(windowing, settings.frame_stride)
        super().__init__(
            network,
            settings,
            windowing,
            (*layers, PREDICTOR) if settings.predictor else layers,
            name=name,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, {PREPROCESSING}",
            layer=PREDICTOR if settings.predictor else layer,
            resolution=settings.resolution,
        )

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        networks: Any = self.network
        patch = self.config.patch_size
        height, width = clips.shape[-2:]
        size = network_size(height, width, self.settings.resolution, patch)
        pixels = imagenet_clips(clips, size, DTYPES[self.settings.dtype])
        frames = clips.shape[1] // self.config.tubelet_size
        rows, columns = size[0] // patch, size[1] // patch
        foresees = layers[-1] == PREDICTOR
        blocks = [int(layer) for layer in layers if layer != PREDICTOR]
        depth = self.config.num_hidden_layers
        run = blocks if depth in blocks or not foresees else [*blocks, depth]
        found, places = encoder_tokens(networks["encoder"], self.config, pixels, run)
        if foresees:
            if rows != columns:
                raise ValueError(
                    f"{self.identity.name}: the predictor takes square frames, got "
                    f"{height} x {width}; pad or crop them"
                )
            masks = [places.expand(len(found[-1]), -1)]
            said = networks["predictor"](found[-1], masks, masks).last_hidden_state
            found = [*found[: len(blocks)], said]
        return [token_maps(tokens, frames, rows, columns) for tokens in found]


def encoder_tokens(
    encoder: Any, config: Any, pixels: Float[Tensor, "n f c h w"], layers: Sequence[int]
) -> tuple[list[Float[Tensor, "n tokens k"]], Int[Tensor, "1 tokens"]]:
    """Tokens after some blocks of the library's encoder, and the numbers of their places.

    Args:
        encoder: the ``VJEPA2Encoder`` of the library.
        config: its configuration.
        pixels: as the network takes them.
        layers: numbers of the blocks, increasing; after the last of all comes the final norm.
    """
    patch = config.patch_size
    frames = pixels.shape[1] // config.tubelet_size
    rows, columns = pixels.shape[-2] // patch, pixels.shape[-1] // patch
    tokens = encoder.embeddings(pixels)
    places = _places(frames, rows, columns, config.crop_size // patch, tokens)
    found = []
    for number, block in enumerate(encoder.layer[: layers[-1]], 1):
        tokens = block(tokens, places)[0]
        if number in layers:
            found.append(tokens)
    if layers[-1] == config.num_hidden_layers:
        found[-1] = encoder.layernorm(tokens)
    return found, places


def _places(
    frames: int, height: int, width: int, side: int, like: Tensor
) -> Int[Tensor, "1 tokens"]:
    """Number of each token on the square grid of ``side`` that positions are computed from."""
    t, y, x = (torch.arange(count, device=like.device) for count in (frames, height, width))
    return (t[:, None, None] * side**2 + y[:, None] * side + x).reshape(1, -1)


def load_vjepa2(
    name: str, settings: VJEPA2Settings, where: Path | None = None, device: str = "cpu"
) -> VJEPA2Encoder:
    """The frozen encoder from its release folder, strictly (see ``load_encoder``)."""
    from transformers import VJEPA2Config, VJEPA2Model

    told = {"model_type": "vjepa2"}
    if settings.seed is not None:
        written = config_of(name, where, told, LARGER.get(name, {}))
        config = VJEPA2Config.from_dict({**written, "crop_size": settings.resolution})
        model, weights = fresh(lambda: VJEPA2Model(config), settings.seed)
    else:
        weights = find_weights(name, where)
        written = read_config(weights.path, told)
        config = VJEPA2Config.from_dict({**written, "crop_size": settings.resolution})
        # without memory until it is loaded: filling a thousand million weights at random is slow
        with torch.device("meta"):
            model = VJEPA2Model(config)
        model.to_empty(device="cpu")
        load_strict(model, weights.path)
    parts = ("encoder", "predictor") if settings.predictor else ("encoder",)
    network = nn.ModuleDict({part: getattr(model, part) for part in parts})
    return VJEPA2Encoder(network.to(device), config, settings, name, weights)
