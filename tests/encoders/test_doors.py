"""`timm:NAME` and `hf:FOLDER`: any network, held to its library's own maps, layer by layer."""

from __future__ import annotations

import json

import pytest
import timm
import torch
import transformers as hub
from safetensors.torch import save_file
from torch.nn import functional

from encoders.frozen import ENCODERS, load_encoder
from encoders.frozen.token_order import ask_order
from encoders.release import WeightsMissing
from registry import RegistryError
from tests.shared.layers import expect_layers

MEAN, STD = (0.4, 0.5, 0.6), (0.2, 0.3, 0.4)
SMALL = {"hidden_size": 32, "num_hidden_layers": 3, "num_attention_heads": 2}
SMALL |= {"intermediate_size": 48, "image_size": 32}
VIT = {**SMALL, "patch_size": 8}
TEXT = {"hidden_size": 32, "intermediate_size": 48, "num_attention_heads": 2}
STAGES = {"hidden_sizes": [8, 12, 16, 24], "depths": [1, 1, 1, 1]}
IMAGES = {
    "vit": lambda: hub.ViTConfig(**VIT),
    "dinov2-registers": lambda: hub.Dinov2WithRegistersConfig(**VIT),
    "dinov3": lambda: hub.DINOv3ViTConfig(**VIT, num_register_tokens=4),
    "dinov3-convnext": lambda: hub.DINOv3ConvNextConfig(**STAGES, image_size=64),
    "siglip": lambda: hub.SiglipVisionConfig(**VIT),
    "clip": lambda: hub.CLIPVisionConfig(**VIT),
    "aimv2": lambda: hub.Aimv2VisionConfig(**VIT),
    "ijepa": lambda: hub.IJepaConfig(**VIT),
    "beit": lambda: hub.BeitConfig(**VIT),
    "resnet": lambda: hub.ResNetConfig(embedding_size=8, **STAGES),
    "swin": lambda: hub.SwinConfig(
        image_size=32, patch_size=4, embed_dim=8, depths=[1, 1], num_heads=[2, 2], window_size=4
    ),
    "hiera": lambda: hub.HieraConfig(
        embed_dim=8, image_size=[64, 64], depths=[1, 1, 1, 1], num_heads=[1, 1, 1, 1]
    ),
}
VIDEOS = {
    "videomae": lambda: hub.VideoMAEConfig(num_frames=4, **VIT),
    "vjepa2": lambda: hub.VJEPA2Config(
        patch_size=8, crop_size=32, frames_per_clip=4, **{k: SMALL[k] for k in list(SMALL)[:3]}
    ),
    "timesformer": lambda: hub.TimesformerConfig(num_frames=4, **VIT),
    "vivit": lambda: hub.VivitConfig(num_frames=4, tubelet_size=[2, 8, 8], **SMALL),
}


def saved(config, folder):
    """A model of fresh weights as its library writes it, and the model."""
    torch.manual_seed(0)
    model = hub.AutoModel.from_config(config).eval()
    model.save_pretrained(folder)
    shown = {"image_mean": MEAN, "image_std": STD, "do_normalize": True, "resample": 3}
    (folder / "preprocessor_config.json").write_text(json.dumps(shown))
    return model


def normalised(frames):
    mean, std = (torch.tensor(x)[:, None, None] for x in (MEAN, STD))
    return (frames - mean) / std


def frames_for(encoder, count):
    side = encoder.identity.resolution
    rng = torch.Generator().manual_seed(1)
    return torch.rand(2, count, 3, side, side, generator=rng), torch.arange(count) / 10


def tokens_only(state, cells):
    """The hidden state of one picture as its library lays it out, ``(cells, k)``."""
    return state[-cells:] if state.ndim == 2 else state.flatten(1).T


@pytest.mark.parametrize("name", sorted(IMAGES))
def test_every_hidden_layer_of_an_image_model_is_its_librarys(name, tmp_path):
    model = saved(IMAGES[name](), tmp_path)
    count = load_encoder(f"hf:{tmp_path}", {}).order.layers
    for layer in range(1, count + 1):
        encoder = load_encoder(f"hf:{tmp_path}", {"layer": layer, "batch": 3})
        frames, times = frames_for(encoder, 2)
        found = encoder(frames, times)
        seen = normalised(frames.flatten(0, 1))
        with torch.no_grad():
            told = model(pixel_values=seen, output_hidden_states=True)
        states = getattr(told, "reshaped_hidden_states", None) or told.hidden_states
        state = states[layer].movedim(-1, 1) if name == "hiera" else states[layer]
        maps = found.values.flatten(0, 1).flatten(2).mT  # (pictures, cells, k)
        for ours, theirs in zip(maps, state, strict=True):
            torch.testing.assert_close(ours, tokens_only(theirs, len(ours)), atol=1e-5, rtol=1e-4)
        assert found.times.tolist() == times.tolist()


@pytest.mark.parametrize("name", sorted(VIDEOS))
def test_every_hidden_layer_of_a_video_model_is_its_librarys_in_time_and_place(name, tmp_path):
    model = saved(VIDEOS[name](), tmp_path)
    for layer in (1, 3):
        encoder = load_encoder(f"hf:{tmp_path}", {"layer": layer})
        frames, times = frames_for(encoder, 4)
        found = encoder(frames, times).values
        key = "pixel_values_videos" if name == "vjepa2" else "pixel_values"
        more = {"skip_predictor": True} if name == "vjepa2" else {}
        with torch.no_grad():
            told = model(**{key: normalised(frames)}, output_hidden_states=True, **more)
        tokens = told.hidden_states[layer][:, -found[:, :, 0].flatten(1).shape[1] :]
        if name == "timesformer":  # rows and columns before moments
            tokens = tokens.unflatten(1, (16, 4)).transpose(1, 2).flatten(1, 2)
        ours = found.permute(0, 1, 3, 4, 2).flatten(1, 3)
        torch.testing.assert_close(ours, tokens, atol=1e-5, rtol=1e-4)
        assert encoder.frames_per_feature == (1 if name == "timesformer" else 2)


NETWORKS = ("test_vit", "test_convnext", "test_resnet", "test_efficientnet", "resnet10t")


@pytest.mark.parametrize("name", NETWORKS)
def test_every_layer_of_a_network_of_timm_is_its_librarys(name):
    extra = {"dynamic_img_size": True} if "vit" in name else {}
    network = timm.create_model(name, pretrained=False, num_classes=0, **extra).eval()
    data = timm.data.resolve_model_data_config(network)
    mean, std = (torch.tensor(data[key])[:, None, None] for key in ("mean", "std"))
    for layer in range(1, len(network.feature_info) + 1):
        encoder = load_encoder(f"timm:{name}", {"layer": layer, "resolution": 64, "seed": 3})
        frames, times = frames_for(encoder, 2)
        network.load_state_dict(encoder.network.state_dict())
        found = encoder(frames, times).values
        last = layer == len(network.feature_info)
        with torch.no_grad():
            (told,) = network.forward_intermediates(
                (frames.flatten(0, 1) - mean) / std,
                indices=[layer - 1],
                norm=last and "vit" in name,
                intermediates_only=True,
            )
        torch.testing.assert_close(found.flatten(0, 1), told, atol=1e-5, rtol=1e-4)


def test_a_release_of_timm_is_loaded_strictly_and_says_how_it_saw(tmp_path):
    torch.manual_seed(1)
    network = timm.create_model("test_vit", num_classes=10)
    save_file(network.state_dict(), tmp_path / "model.safetensors")
    told = {"architecture": "test_vit", "pretrained_cfg": {"mean": MEAN, "std": STD}}
    (tmp_path / "config.json").write_text(json.dumps(told))
    encoder = load_encoder("timm:test_vit", {}, tmp_path)
    assert encoder.look.mean == MEAN and encoder.look.std == STD
    torch.testing.assert_close(
        encoder.network.blocks[0].attn.qkv.weight, network.blocks[0].attn.qkv.weight
    )
    wrong = {**network.state_dict(), "blocks.99.norm": torch.ones(1)}
    save_file(wrong, tmp_path / "model.safetensors")
    with pytest.raises(ValueError, match=r"1 unknown \['blocks.99.norm'\]"):
        load_encoder("timm:test_vit", {}, tmp_path)


def test_pictures_of_another_shape_are_resized_whole_by_the_models_own_filter(tmp_path):
    saved(IMAGES["vit"](), tmp_path)
    encoder = load_encoder(f"hf:{tmp_path}", {})
    frames = torch.rand(1, 1, 3, 40, 50, generator=torch.Generator().manual_seed(2))
    small = functional.interpolate(frames[0], (32, 32), mode="bicubic", antialias=True)
    found, told = (encoder(x, torch.zeros(1)) for x in (frames, small.clamp(0, 1)[None]))
    torch.testing.assert_close(found.values, told.values)
    assert found.stride == (10.0, 12.5)


@pytest.mark.parametrize("name", ["vit", "dinov3-convnext", "vjepa2", "timesformer", "timm"])
def test_all_layers_in_one_pass(name, tmp_path):
    door, options = f"hf:{tmp_path}", {"batch": 3}
    if name == "timm":
        door, options = "timm:test_vit", {"batch": 3, "seed": 0, "resolution": 64}
    else:
        saved((IMAGES | VIDEOS)[name](), tmp_path)
    encoder = load_encoder(door, options)
    frames, _ = frames_for(encoder, 2 if name in IMAGES else 4)
    passes = -(-len(frames) * (frames.shape[1] if encoder.windowing.frames == 1 else 1) // 3)
    expect_layers(
        encoder, lambda layer: load_encoder(door, {**options, "layer": layer}), frames, passes
    )


def test_bfloat16_is_near_and_named(tmp_path):
    saved(IMAGES["dinov3"](), tmp_path)
    exact = load_encoder(f"hf:{tmp_path}", {})
    short = load_encoder(f"hf:{tmp_path}", {"dtype": "bfloat16"})
    clip = frames_for(exact, 2)
    a, b = exact(*clip).values, short(*clip).values
    assert 1e-5 < float((a - b).norm() / a.norm()) < 0.05
    assert exact.identity != short.identity


def test_fresh_weights_are_a_control_that_repeats_and_is_another_encoder():
    one, two, other = (load_encoder("timm:test_vit", {"seed": seed}) for seed in (0, 0, 1))
    clip = frames_for(one, 1)
    assert torch.equal(one(*clip).values, two(*clip).values)
    assert not torch.equal(one(*clip).values, other(*clip).values)
    assert one.identity == two.identity != other.identity
    assert ENCODERS.source("timm:test_vit").ours


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("timm:no_such_net", {"seed": 0}, "unknown network of timm 'no_such_net'"),
        ("timm:test_vit", {"seed": 0, "layer": 99}, "no layer 99; it has 1 to"),
        ("timm:hiera_tiny_224", {"seed": 0, "resolution": 96}, "sees images of 224 pixels only"),
        ("timm:test_vit", {"seed": 0, "hop": 2}, "takes no hop"),
    ],
)
def test_what_cannot_be_is_said(name, options, said):
    with pytest.raises(ValueError, match=said):
        load_encoder(name, options)


def test_weights_that_are_not_here_say_how_to_get_them(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    with pytest.raises(
        WeightsMissing, match="weights fetch timm:vit_tiny_patch16_224`, or copy config.json"
    ):
        load_encoder("timm:vit_tiny_patch16_224", {})
    with pytest.raises(WeightsMissing, match="weights fetch hf:some/where`, or copy"):
        load_encoder("hf:some/where", {})
    with pytest.raises(WeightsMissing, match="no weights in such a folder or in the hub's cache"):
        load_encoder(f"hf:{tmp_path / 'nowhere'}", {})


@pytest.mark.parametrize(
    ("config", "said"),
    [
        (lambda: hub.BertConfig(**{**SMALL, "vocab_size": 20}), "does not see pictures"),
        (
            lambda: hub.Siglip2VisionConfig(num_patches=16, patch_size=8, **SMALL),
            "sees more than pictures",
        ),
    ],
    ids=["text", "patches"],
)
def test_a_model_that_is_none_for_clips_is_refused_in_a_line(config, said, tmp_path):
    told = config()
    told.image_size = 32
    saved(told, tmp_path)
    with pytest.raises(ValueError, match=said) as caught:
        load_encoder(f"hf:{tmp_path}", {})
    assert "\n" not in str(caught.value)


def test_a_model_of_which_weights_are_missing_is_refused(tmp_path):
    model = saved(IMAGES["vit"](), tmp_path)
    state = {k: v for k, v in model.state_dict().items() if "pooler" not in k}
    state.pop(next(key for key in state if "layernorm" in key))
    save_file(state, tmp_path / "model.safetensors", {"format": "pt"})
    with pytest.raises(ValueError, match="weights are missing"):
        load_encoder(f"hf:{tmp_path}", {})


def test_an_order_that_is_not_known_is_refused_rather_than_guessed():
    mixed = torch.randperm(16, generator=torch.Generator().manual_seed(0))

    def states(pixels):
        cells = functional.avg_pool2d(pixels, 8).flatten(2).mT
        return cells[:, mixed], cells

    with pytest.raises(ValueError, match="in no order that is known"):
        ask_order("mixed", states, torch.zeros(1, 3, 32, 32))


def test_a_door_that_leads_nowhere_is_an_import_path():
    with pytest.raises(RegistryError, match="cannot be imported"):
        load_encoder("no_such_package:encoder", {})


@pytest.mark.parametrize("told", ["pe_video", "pe_video_encoder"])
def test_a_model_with_a_token_a_frame_is_its_librarys_whatever_the_length(tmp_path, told):
    sees = {
        **TEXT,
        "num_hidden_layers": 2,
        "head_dim": 16,
        "vision_config": {
            "architecture": "vit_pe_core_small_patch16_384",
            "model_args": {"embed_dim": 32, "depth": 1, "num_heads": 2, "img_size": 32},
            "num_classes": 24,
        },
    }
    reads = {"model_type": "modernbert", "num_hidden_layers": 1, **TEXT}
    if told == "pe_video":
        model = saved(hub.PeVideoConfig(video_config=sees, text_config=reads), tmp_path)
        model = model.video_encoder
    else:
        model = saved(hub.PeVideoEncoderConfig(**sees), tmp_path)
    shown = json.loads((tmp_path / "preprocessor_config.json").read_text())
    size = {"size": {"height": 32, "width": 32}}
    (tmp_path / "preprocessor_config.json").write_text(json.dumps(shown | size))
    encoder = load_encoder(f"hf:{tmp_path}", {"batch": 1})
    frames, times = frames_for(encoder, 16)
    found = encoder.encode_layers(frames, times, encoder.layers)
    with torch.no_grad():
        states = []
        for layer in model.layers:
            layer.register_forward_hook(lambda _, __, out: states.append(out[:, 1:]))
        states[-1:] = [model(normalised(frames)).last_hidden_state]
    assert len(encoder.layers) == len(states) == 2
    for maps, state in zip(found.values(), states, strict=True):
        torch.testing.assert_close(maps.values[..., 0, 0], state, atol=1e-5, rtol=1e-4)
        assert maps.times.tolist() == times.tolist()
    short = load_encoder(f"hf:{tmp_path}", {"dtype": "bfloat16"})(frames, times).values
    assert float((short - found["2"].values).norm() / short.norm()) < 0.05
