"""V-JEPA 2-AC (Assran et al., arXiv:2506.09985): an encoder, and a predictor of the next frame.

The weights are the one file of the official release, ``vjepa2-ac-vitg.pt``: a dictionary whose
``encoder`` and ``predictor`` hold the tensors. What else is in it is not read; sizes are those of
the tensors.

The predictor was trained on a robot arm, frame by frame: each frame is encoded as a tubelet of two
copies of it, and its tokens are normalised. Here the arm does nothing: its action is zero, and its
state is one of :data:`STATES`. A feature frame is what the predictor says of the next one, from
the frames of the window up to its own; or, where the predictor is not asked for, the frame's own
tokens.

One frame and any other number are taken; a long clip is seen in windows as by V-JEPA 2. A feature
frame's time is that of its frame.
"""

from __future__ import annotations

import pickle
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from encoders.frozen.base import DTYPES, Dtype, FrozenEncoder
from encoders.frozen.tokens import token_maps, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.vjepa2 import encoder_tokens
from encoders.frozen.vjepa2_ac_network import HEAD, Predictor
from encoders.frozen.windows import Windowing
from encoders.preprocess import imagenet_clips, network_size
from encoders.release import WeightsFile, load_tensors
from encoders.weights import find_weights

NAME = "vjepa2-ac"
CODE_VERSION = 1
# of the release: the encoder, and the predictor's channels, width, hidden width and depth
RELEASED = {"hidden_size": 1408, "num_hidden_layers": 40, "mlp_ratio": 48 / 11}
FORESEES = (1408, 1024, 4096, 24)
OWN = "encoder"  # the layer of a frame's own tokens; the predictor's is the other
PREPROCESSING = "rgb, the image to the square, bilinear, imagenet, each frame doubled"
# the arm's place (metres), angles (radians) and gripper
STATES = {"zero": (0.0,) * 7, "resting": (0.5, 0.0, 0.3, 3.14159265, 0.0, 0.0, 0.0)}


@dataclass(frozen=True)
class VJEPA2ACSettings:
    """What is read, and at which cost.

    Args:
        predictor: read what the predictor says of the next frame, not the frame's own tokens.
        state: of the arm that does nothing.
        resolution: network pixels of a side of the square, a multiple of the patch.
        frames: in a window.
        hop: frames from a window's start to the next one's; ``frames`` where not given.
        frame_stride: take each so-many-th frame, before windows are made.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per forward pass.
    """

    predictor: bool = True
    state: Literal["zero", "resting"] = "zero"
    resolution: int = 256
    frames: int = 16
    hop: int | None = None
    frame_stride: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1


class VJEPA2ACEncoder(FrozenEncoder):
    """Windows of frames to maps of tokens, one for each frame.

    Args:
        network: ``encoder``, as the library has it, and ``predictor``.
        config: the library's configuration of the encoder, made for ``settings.resolution``.
        settings: see :class:`VJEPA2ACSettings`.
        weights: the file that the network was loaded from.

    Raises:
        ValueError: a resolution or a window that the network does not have.
    """

    def __init__(
        self, network: nn.ModuleDict, config: Any, settings: VJEPA2ACSettings, weights: WeightsFile
    ) -> None:
        network_size(1, 1, settings.resolution, config.patch_size)
        self.config = config
        windowing = Windowing(settings.frames, settings.hop, shortens=True)
        words = windowing_words(windowing, settings.frame_stride)
        foreseen = f"predictor, state {settings.state}"
        super().__init__(
            network,
            settings,
            windowing,
            (OWN, foreseen) if settings.predictor else (OWN,),
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, {PREPROCESSING}",
            layer=foreseen if settings.predictor else OWN,
            resolution=settings.resolution,
        )

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n f k h w"]]:
        seen = self.see(clips)
        return [seen if layer == OWN else self.foresee(seen) for layer in layers]

    def see(self, clips: Float[Tensor, "n f c H W"]) -> Float[Tensor, "n f k h w"]:
        """Normalised tokens of each frame by itself."""
        side = self.settings.resolution
        pixels = imagenet_clips(clips, (side, side), DTYPES[self.settings.dtype])
        doubled = pixels.flatten(0, 1).unsqueeze(1).expand(-1, self.config.tubelet_size, -1, -1, -1)
        networks: Any = self.network
        depth = self.config.num_hidden_layers
        (tokens,), _ = encoder_tokens(networks["encoder"], self.config, doubled, [depth])
        grid = side // self.config.patch_size
        maps = token_maps(_normalised(tokens), 1, grid, grid)
        return maps.flatten(0, 1).unflatten(0, clips.shape[:2])

    def foresee(self, seen: Float[Tensor, "n f k h w"]) -> Float[Tensor, "n f k h w"]:
        """What the predictor says of the frame after each, from tokens of :meth:`see`."""
        networks: Any = self.network
        action = seen.new_zeros(len(STATES["zero"]))
        state = seen.new_tensor(STATES[self.settings.state])
        h, w = seen.shape[-2:]
        said = networks["predictor"](seen.flatten(-2).mT, (h, w), action, state)
        return _normalised(said).mT.unflatten(-1, (h, w))


def _normalised(tokens: Tensor) -> Tensor:
    return functional.layer_norm(tokens, tokens.shape[-1:])


def load_vjepa2_ac(
    settings: VJEPA2ACSettings, where: Path | None = None, device: str = "cpu"
) -> VJEPA2ACEncoder:
    """The frozen encoder and predictor from the official file, strictly."""
    from transformers.models.vjepa2.modeling_vjepa2 import VJEPA2Encoder

    if settings.seed is not None:
        config = _config(RELEASED, settings.resolution)

        def build() -> nn.ModuleDict:
            parts = {"encoder": VJEPA2Encoder(config), "predictor": Predictor(*FORESEES)}
            return nn.ModuleDict(parts)

        drawn, none = fresh(build, settings.seed)
        return VJEPA2ACEncoder(drawn.to(device), config, settings, none)
    weights = find_weights(NAME, where)
    parts = read_release(weights.path)
    config = encoder_config(parts["encoder"], settings.resolution)
    # without memory until it is loaded: filling a thousand million weights at random is slow
    with torch.device("meta"):
        network = nn.ModuleDict(
            {"encoder": VJEPA2Encoder(config), "predictor": _predictor(parts["predictor"])}
        )
    network.to_empty(device="cpu")
    encoder, predictor = network["encoder"], network["predictor"]
    load_tensors(encoder, weights.path, _by_library_names(parts["encoder"]))
    load_tensors(predictor, weights.path, parts["predictor"])
    return VJEPA2ACEncoder(network.to(device), config, settings, weights)


def read_release(path: Path) -> dict[str, dict[str, Tensor]]:
    """Tensors of ``encoder`` and ``predictor``, without the prefixes that training put there.

    Raises:
        ValueError: another kind of file.
    """
    try:
        whole = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
        parts = {part: whole[part] for part in ("encoder", "predictor")}
    except (RuntimeError, KeyError, TypeError, pickle.UnpicklingError) as error:
        raise ValueError(
            f"weights: {path} is not the release of {NAME}: no `encoder` and `predictor` could be "
            "read from it; fetch it again"
        ) from error
    clean = re.compile(r"module\.|backbone\.")
    return {
        part: {clean.sub("", key): value for key, value in tensors.items()}
        for part, tensors in parts.items()
    }


def encoder_config(tensors: dict[str, Tensor], resolution: int) -> Any:
    """The library's configuration of an encoder with these tensors."""
    width, _, tubelet, patch, _ = tensors["patch_embed.proj.weight"].shape
    sizes = {
        "patch_size": patch,
        "tubelet_size": tubelet,
        "hidden_size": width,
        "num_hidden_layers": _depth(tensors, "blocks"),
        # the library rounds the product down
        "mlp_ratio": (tensors["blocks.0.mlp.fc1.weight"].shape[0] + 0.5) / width,
    }
    return _config(sizes, resolution)


def _config(sizes: dict[str, Any], resolution: int) -> Any:
    from transformers import VJEPA2Config

    heads = sizes["hidden_size"] // HEAD
    config: Any = VJEPA2Config(crop_size=resolution, num_attention_heads=heads, **sizes)
    config._attn_implementation = "sdpa"  # as the library sets it for a whole model
    return config


def _predictor(tensors: dict[str, Tensor]) -> Predictor:
    width, channels = tensors["predictor_embed.weight"].shape
    hidden = tensors["predictor_blocks.0.mlp.fc1.weight"].shape[0]
    return Predictor(channels, width, hidden, _depth(tensors, "predictor_blocks"))


def _depth(tensors: dict[str, Tensor], blocks: str) -> int:
    return 1 + max(int(key.split(".")[1]) for key in tensors if key.startswith(f"{blocks}."))


def _by_library_names(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The encoder's tensors under the library's names; its queries, keys and values stand apart."""
    renamed = {}
    for key, value in tensors.items():
        key = key.replace("patch_embed.", "embeddings.patch_embeddings.")
        key = re.sub(r"^blocks\.", "layer.", re.sub(r"^norm\.", "layernorm.", key))
        key = key.replace(".attn.", ".attention.")
        if ".qkv." in key:
            for name, part in zip(("query", "key", "value"), value.chunk(3), strict=True):
                renamed[key.replace(".qkv.", f".{name}.")] = part
        elif key != "pos_embed":  # of a variant without rotary places; the release has both
            renamed[key] = value
    return renamed
