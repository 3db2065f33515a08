"""SAM 2's video memory (Ravi et al., arXiv:2408.00714), frozen; its prompt is the whole picture.

The network follows what somebody marks. Here nobody marks anything: the mask of a window's first
frame is all of it, and what each later frame remembers of the frames before, the library's own
session works out. Two layers are read: ``image``, a frame's own features as the memory sees them,
and ``memory``, the same after they have looked at the memories; a first frame has none, and says so
by the network's own embedding of that.

A clip is seen in windows of ``frames`` frames, side by side unless ``hop`` is less, and a last one
that ends with the clip; a shorter clip makes a shorter window. Pictures are stretched to squares,
as the library's processor does. A feature frame is its frame, at its own time.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.base import Dtype, FrozenEncoder
from encoders.frozen.tokens import chosen_layer, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.preprocess import imagenet_clips, network_size
from encoders.release import WeightsFile, load_strict, read_config
from encoders.weights import config_of, find_weights

NAME = "sam2-memory"
CODE_VERSION = 1
STRIDES = (4, 8, 16)  # network pixels of a cell, of the levels that the trunk hands on
MULTIPLE = 32  # of a side: the trunk halves it once more than the last level has it
PREPROCESSING = "rgb, stretched to a square, bilinear, imagenet, the whole picture as first mask"
IMAGE, MEMORY = LAYERS = ("image", "memory")


@dataclass(frozen=True)
class Sam2MemorySettings:
    """What is read, and at which cost.

    Args:
        layer: ``image`` or ``memory``.
        resolution: network pixels of a side, a multiple of 32; a cell has 16.
        frames: in a window.
        hop: frames from a window's start to the next one's; ``frames`` where not given.
        frame_stride: take each so-many-th frame, before windows are made.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per pass.
    """

    layer: int | str = MEMORY
    resolution: int = 1024
    frames: int = 8
    hop: int | None = None
    frame_stride: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1


class Sam2MemoryEncoder(FrozenEncoder):
    """Windows of frames to maps of what each frame sees and remembers.

    Args:
        network: the ``Sam2VideoModel`` of the library, made for ``settings.resolution``.
        settings: see :class:`Sam2MemorySettings`.
        weights: what the network was loaded from.

    Raises:
        ValueError: a layer, a resolution or a window that the network does not have.
    """

    def __init__(
        self, network: nn.Module, settings: Sam2MemorySettings, weights: WeightsFile
    ) -> None:
        windowing = Windowing(settings.frames, settings.hop, shortens=True)
        words = windowing_words(windowing, settings.frame_stride)
        super().__init__(
            network,
            settings,
            windowing,
            LAYERS,
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, {PREPROCESSING}",
            layer=chosen_layer(NAME, settings.layer, LAYERS),
            resolution=settings.resolution,
        )

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        side = self.settings.resolution
        pixels = imagenet_clips(clips, (side, side), self.dtype)
        found = [self._remembered(clip) for clip in pixels]
        return [torch.stack([maps[layer] for maps in found]) for layer in layers]

    def _remembered(self, clip: Float[Tensor, "f 3 h w"]) -> dict[str, Float[Tensor, "f k y x"]]:
        """Both layers of one window."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        side = clip.shape[-1]
        network: Any = self.network
        session = Sam2VideoInferenceSession(
            clip, side, side, clip.device, clip.device, clip.device, clip.dtype
        )
        thing = session.obj_id_to_idx(1)
        session.add_mask_inputs(thing, 0, clip.new_ones(1, 1, side, side))
        session.obj_with_new_inputs.append(1)
        with _watched(network) as (seen, recalled):
            for frame in range(len(clip)):
                network(session, frame_idx=frame)
        image, none = torch.cat(seen), network.no_memory_embedding.reshape(-1, 1, 1)
        later = [x.reshape(-1, *image.shape[-2:], image.shape[1]) for x in recalled]
        memory = torch.cat([image[:1] + none, *(x.permute(0, 3, 1, 2) for x in later)])
        return {IMAGE: image, MEMORY: memory}


@contextmanager
def _watched(network: Any) -> Iterator[tuple[list[Tensor], list[Tensor]]]:
    """Features of each frame, and those of later ones after they looked at the memories."""
    seen: list[Tensor] = []
    recalled: list[Tensor] = []
    hooks = [
        network.vision_encoder.register_forward_hook(
            lambda _, __, found: seen.append(found.fpn_hidden_states[-1])
        ),
        network.memory_attention.register_forward_hook(lambda _, __, found: recalled.append(found)),
    ]
    try:
        yield seen, recalled
    finally:
        for hook in hooks:
            hook.remove()


def load_sam2_memory(
    settings: Sam2MemorySettings, where: Path | None = None, device: str = "cpu"
) -> Sam2MemoryEncoder:
    """The frozen encoder from its release folder, strictly (see ``load_encoder``)."""
    from transformers import Sam2VideoConfig, Sam2VideoModel

    told = {"model_type": "sam2_video"}
    network_size(1, 1, settings.resolution, MULTIPLE)

    def config(written: dict[str, Any]) -> Any:
        return Sam2VideoConfig.from_dict(_sized(written, settings.resolution))

    model: Any
    if settings.seed is not None:
        written = config_of(NAME, where, told, {})
        model, weights = fresh(lambda: Sam2VideoModel(config(written)), settings.seed)
    else:
        weights = find_weights(NAME, where)
        model = Sam2VideoModel(config(read_config(weights.path, told)))
        load_strict(model, weights.path)
    return Sam2MemoryEncoder(model.to(device), settings, weights)


def _sized(config: dict[str, Any], side: int) -> dict[str, Any]:
    """A configuration for pictures of another size."""
    sight, prompt = (config.get(f"{part}_config") or {} for part in ("vision", "prompt_encoder"))
    cells = [[side // stride] * 2 for stride in STRIDES]
    trunk = {**(sight.get("backbone_config") or {}), "image_size": [side, side]}
    trunk.setdefault("model_type", "sam2_hiera_det_model")
    return {
        **config,
        "image_size": side,
        "memory_attention_rope_feat_sizes": cells[-1],
        "vision_config": {**sight, "backbone_config": trunk, "backbone_feature_sizes": cells},
        "prompt_encoder_config": {**prompt, "image_size": side},
    }
