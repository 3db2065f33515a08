"""SAM 2's video memory: a tiny release in the official layout, held to the library's session."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor
from transformers import Sam2VideoConfig, Sam2VideoModel
from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

from encoders.frozen import load_encoder
from encoders.frozen.untrained import drawn_anew
from encoders.weights import lock
from tests.shared.layers import expect_layers

SIDE, NAME = 64, "sam2-memory"
WIDTH, MEMORY = (
    128,
    64,
)  # channels of the maps, and of a memory, of which the library knows no other
TRUNK = {
    "model_type": "sam2_hiera_det_model",
    "hidden_size": 8,
    "embed_dim_per_stage": [8, 16, 32, 64],
    "blocks_per_stage": [1, 1, 2, 1],
    "num_attention_heads_per_stage": [1, 1, 2, 2],
    "window_size_per_stage": [8, 4, 4, 4],
    "global_attention_blocks": [3],
}
TINY: dict[str, Any] = {
    "model_type": "sam2_video",
    "vision_config": {
        "model_type": "sam2_vision_model",
        "backbone_config": TRUNK,
        "backbone_channel_list": [64, 32, 16, 8],
        "fpn_hidden_size": WIDTH,
    },
    "prompt_encoder_config": {"hidden_size": WIDTH},
    "mask_decoder_config": {"hidden_size": WIDTH, "mlp_dim": 16, "iou_head_hidden_dim": 16},
    "memory_attention_hidden_size": WIDTH,
    "memory_attention_num_layers": 2,
    "memory_attention_feed_forward_hidden_size": 16,
    "memory_encoder_hidden_size": WIDTH,
    "memory_encoder_output_channels": MEMORY,
    "mask_downsampler_embed_dim": WIDTH,
    "memory_fuser_embed_dim": WIDTH,
    "memory_fuser_intermediate_dim": 16,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights")
    model = drawn_anew(Sam2VideoModel(Sam2VideoConfig.from_dict(TINY)), 0)
    with torch.no_grad():
        model.no_memory_embedding.fill_(0.5)
    model.save_pretrained(path / NAME)
    lock(path / NAME, None)
    return path


def encoder_of(folder: Path, **options: Any) -> Any:
    return load_encoder(NAME, {"resolution": SIDE, "frames": 4, **options}, folder)


def clip(frames: int) -> Tensor:
    rng = torch.Generator().manual_seed(frames)
    return torch.rand(1, frames, 3, 48, 80, generator=rng)


def by_the_library(network: Any, frames: Tensor) -> tuple[Tensor, Tensor]:
    """What its own tracker conditions on memory, ``(f, k, h, w)``, and the maps before that."""
    pixels = torch.nn.functional.interpolate(frames, (SIDE, SIDE), mode="bilinear", antialias=True)
    mean, std = (
        torch.tensor(x)[:, None, None] for x in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))
    )
    session = Sam2VideoInferenceSession((pixels - mean) / std, SIDE, SIDE, dtype=torch.float32)
    session.add_mask_inputs(session.obj_id_to_idx(7), 0, torch.ones(1, 1, SIDE, SIDE))
    session.obj_with_new_inputs = [7]
    image, memory = [], []
    for frame in range(len(frames)):
        features, places = network._prepare_vision_features(session, frame, 1)
        image.append(features[-1].permute(1, 2, 0).reshape(-1, SIDE // 16, SIDE // 16))
        conditioned = network._prepare_memory_conditioned_features(
            session, frame, 0, frame == 0, features[-1], places[-1], len(frames)
        )
        memory.append(conditioned[0])
        network(session, frame_idx=frame)
    return torch.stack(image), torch.stack(memory)


def test_both_layers_are_the_librarys_own(folder):
    encoder, frames = encoder_of(folder), clip(4)
    times = torch.arange(4) / 10
    found = encoder.encode_layers(frames, times, ("image", "memory"))
    image, memory = by_the_library(encoder.network, frames[0])
    torch.testing.assert_close(found["image"].values[0], image, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(found["memory"].values[0], memory, rtol=1e-4, atol=1e-5)
    assert found["memory"].stride == (12.0, 20.0) and torch.equal(found["memory"].times, times)


def test_memory_tells_what_went_before_and_an_image_does_not(folder):
    encoder, frames = encoder_of(folder), clip(4)
    other = frames.clone()
    other[:, 0] = 1 - other[:, 0]
    image, memory = (
        [encoder.at(layer)(x, torch.arange(4) / 10).values[0] for x in (frames, other)]
        for layer in ("image", "memory")
    )
    torch.testing.assert_close(image[0][1:], image[1][1:])
    assert (memory[0][1:] - memory[1][1:]).abs().amax((1, 2, 3)).min() > 1e-4


def test_each_layer_alone_is_that_of_all_and_a_last_window_ends_with_the_clip(folder):
    encoder = encoder_of(folder)
    expect_layers(encoder, lambda layer: encoder_of(folder, layer=layer), clip(6), passes=2)
    long, last = clip(6), clip(6)[:, 2:]
    told = [encoder(x, torch.arange(x.shape[1]) / 10).values[0] for x in (long, last)]
    torch.testing.assert_close(told[0][4:], told[1][2:])


def test_a_batch_and_a_shorter_number_format_are_near(folder):
    frames, times = clip(8), torch.arange(8) / 10
    one = encoder_of(folder)(frames, times).values
    both = encoder_of(folder, batch=2)(frames, times).values
    torch.testing.assert_close(one, both, rtol=1e-4, atol=1e-5)
    short = encoder_of(folder, dtype="bfloat16")(frames, times).values
    assert 0 < (short - one).norm() / one.norm() < 0.05


def test_another_size_and_untrained_weights(folder):
    larger = encoder_of(folder, resolution=96)(clip(2), torch.arange(2) / 10)
    assert tuple(larger.values.shape) == (1, 2, WIDTH, 6, 6)
    control = encoder_of(folder, seed=0)
    assert "drawn anew" in control.identity.weights_sha256
    with pytest.raises(ValueError, match="must be a multiple of 32"):
        encoder_of(folder, resolution=40)
    with pytest.raises(ValueError, match="image, memory"):
        encoder_of(folder, layer="mask")
