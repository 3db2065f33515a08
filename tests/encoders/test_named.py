"""Encoders behind a door that have a name here: held to their library's own hidden states.

Each is a small release in the official layout, of weights that its library drew. What is compared
with are the outputs of the library's own modules while it runs its own forward pass.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import timm
import torch
import transformers as hub
from safetensors.torch import save_file
from torch.nn import functional
from torchvision.models import get_model_builder, get_model_weights
from torchvision.models.video.mvit import MSBlockConfig, MViT

from encoders.frozen import ENCODERS, load_encoder
from encoders.frozen.any_torchvision import TorchvisionEncoder, TorchvisionSettings
from encoders.known_weights import KNOWN
from encoders.preprocess import LOOKS, Look
from encoders.release import WeightsFile
from encoders.weights import lock

VIT = {"embed_dim": 32, "depth": 2, "num_heads": 2}
STAGED = {"depths": (1, 1, 1, 1), "dims": (8, 12, 16, 24)}
SMALL = {"hidden_size": 32, "num_attention_heads": 2, "intermediate_size": 48, "image_size": 32}
CLIP = {"patch_size": 8, "num_hidden_layers": 2, **SMALL}
# what makes the library's network small
OF_TIMM = {
    "dinov2-small-reg": {**VIT, "img_size": 56},
    "dinov3-small": {**VIT, "img_size": 64},
    "dinov3-base": {**VIT, "img_size": 64},
    "dinov3-convnext": STAGED,
    "siglip2-base": {**VIT, "img_size": 64},
    "pe-core-small": {**VIT, "img_size": 64},
    "pe-spatial-small": {**VIT, "img_size": 64},
    "eupe-small": {**VIT, "img_size": 64},
    "aimv2-large": {**VIT, "img_size": 56},
    "radio-base": {**VIT, "img_size": 64},
    "ijepa-huge": {**VIT, "img_size": 56},
    "clip-base": {**VIT, "img_size": 64},
    "mae-base": {**VIT, "img_size": 64},
    "resnet50": {"layers": (1, 1, 1, 1)},
    "convnext-tiny": STAGED,
}
OF_HUB = {
    "timesformer": lambda: hub.TimesformerConfig(num_frames=4, **CLIP),
    "vivit": lambda: hub.VivitConfig(
        num_frames=4, tubelet_size=[2, 8, 8], num_hidden_layers=2, **SMALL
    ),
    "xclip": lambda: hub.XCLIPConfig(
        vision_config={
            "num_frames": 4,
            "mit_hidden_size": 32,
            "mit_intermediate_size": 48,
            "mit_num_attention_heads": 2,
            "mit_num_hidden_layers": 1,
            **CLIP,
        },
        text_config={"num_hidden_layers": 1, "hidden_size": 32, "num_attention_heads": 2},
    ),
    "videoprism": lambda: hub.VideoPrismVisionConfig(
        num_frames=4,
        tubelet_size=[1, 8, 8],
        num_spatial_layers=2,
        num_temporal_layers=2,
        **SMALL,
    ),
}
OF_TORCHVISION = {"s3d": 16, "r2plus1d": 8, "swin3d": 4}  # frames of a window
TIMES = torch.arange(16, dtype=torch.float64) / 25


def clip(frames, height, width):
    rng = torch.Generator().manual_seed(1)
    return torch.randint(256, (2, frames, 3, height, width), generator=rng, dtype=torch.uint8)


def shown(encoder, frames):
    """Pixels ``(n, f, 3, h, w)``, resized and normalised by hand."""
    look, side = encoder.look, encoder.identity.resolution
    pixels = frames.flatten(0, 1).float() / 255
    if pixels.shape[-2:] != (side, side):
        pixels = functional.interpolate(pixels, (side, side), mode=look.mode, antialias=True)
        pixels = pixels.clamp(0, 1)
    mean, std = (torch.tensor(x)[:, None, None] for x in (look.mean, look.std))
    return ((pixels - mean) / std).unflatten(0, frames.shape[:2])


def outputs(network, modules, *args, **kwargs):
    """What the network's own modules give while it is run."""
    seen = []
    hooks = [
        module.register_forward_hook(lambda _, __, out: seen.append(out)) for module in modules
    ]
    with torch.no_grad():
        network(*args, **kwargs)
    for hook in hooks:
        hook.remove()
    return [out[0] if isinstance(out, tuple) else out for out in seen]


def expect(encoder, name, told, frames, options=None):
    """Every layer, a batch of another size, another shape of picture, and bfloat16."""
    times = TIMES[: frames.shape[1]]
    found = encoder.encode_layers(frames, times, encoder.layers)
    states = told(encoder, shown(encoder, frames))
    assert len(states) == len(encoder.layers)
    for layer, state in zip(encoder.layers, states, strict=True):
        values = found[layer].values
        assert values.shape == state.shape, (name, layer)
        torch.testing.assert_close(values, state, atol=2e-4, rtol=1e-3)
    for early, late in zip(states, states[1:], strict=False):  # or it shows nothing
        assert early.shape != late.shape or (early - late).norm() > 1e-4 * late.norm()


def release_of_timm(name, folder):
    arch = KNOWN[name].door.partition(":")[2]
    torch.manual_seed(0)
    network = timm.create_model(arch, pretrained=False, num_classes=0, **OF_TIMM[name]).eval()
    for key, weight in network.named_parameters():  # or a block would hardly change its input
        if key.endswith("gamma"):
            weight.data.fill_(1.0)
    told = {"architecture": arch.partition(".")[0], "model_args": OF_TIMM[name]}
    (folder / name).mkdir()
    save_file(network.state_dict(), folder / name / "model.safetensors")
    (folder / name / "config.json").write_text(json.dumps(told))
    lock(folder / name, None)
    return network


def states_of_timm(network, pixels):
    flat = pixels.flatten(0, 1)
    blocks = getattr(network, "blocks", None) or getattr(network, "stages", None)
    if blocks is None:
        blocks = [network.act1, network.layer1, network.layer2, network.layer3, network.layer4]
    states = outputs(network, blocks, flat)
    if hasattr(network, "blocks"):
        norm = network.norm
        with torch.no_grad():
            states[-1] = norm(states[-1])
        states = [x[:, network.num_prefix_tokens :] for x in states]
        side = int(states[0].shape[1] ** 0.5)
        states = [x.unflatten(1, (side, side)).permute(0, 3, 1, 2) for x in states]
    return [x.unflatten(0, pixels.shape[:2]) for x in states]


@pytest.mark.parametrize("name", OF_TIMM)
def test_an_image_encoder_is_its_librarys_in_every_layer(name, tmp_path):
    network = release_of_timm(name, tmp_path)
    side = OF_TIMM[name].get("img_size", 64)
    options = {"resolution": side, "batch": 3}
    encoder = load_encoder(name, options, tmp_path)
    assert encoder.identity.name == name
    expect(encoder, name, lambda _, x: states_of_timm(network, x), clip(2, side, side))
    wide = clip(2, side, side)[..., : side // 2, :].repeat(1, 1, 1, 2, 1)
    small = load_encoder(name, {**options, "batch": 1, "dtype": "bfloat16"}, tmp_path)
    exact, short = (each(wide, TIMES[:2]).values for each in (encoder, small))
    assert 1e-5 < float((exact - short).norm() / exact.norm()) < 0.05


@pytest.mark.parametrize("name", OF_HUB)
def test_a_video_encoder_is_its_librarys_in_every_layer(name, tmp_path):
    torch.manual_seed(0)
    model = hub.AutoModel.from_config(OF_HUB[name]()).eval()
    model.save_pretrained(tmp_path / name)
    lock(tmp_path / name, None)
    encoder = load_encoder(name, {"batch": 2}, tmp_path)
    assert encoder.look == LOOKS[KNOWN[name].look]

    def told(_, pixels):
        return states_of_hub(name, getattr(model, "vision_model", model), pixels)

    expect(encoder, name, told, clip(4, 32, 32))
    expect(encoder, name, told, clip(4, 40, 24))
    short = load_encoder(name, {"batch": 1, "dtype": "bfloat16"}, tmp_path)
    frames = clip(4, 40, 24)
    exact, found = (each(frames, TIMES[:4]).values for each in (encoder, short))
    assert 1e-5 < float((exact - found).norm() / exact.norm()) < 0.05
    single = load_encoder(name, {"batch": 1}, tmp_path)(frames, TIMES[:4]).values
    torch.testing.assert_close(single, exact, atol=1e-5, rtol=1e-4)


def states_of_hub(name, model, pixels):
    n, frames = pixels.shape[:2]
    if name == "xclip":
        found = outputs(model, model.encoder.layers, pixel_values=pixels.flatten(0, 1))
        return [_grid(x[:, 1:].unflatten(0, (n, frames))) for x in found]
    if name == "videoprism":
        layers = [*model.spatial_layers, *model.temporal_layers]
        found = outputs(model, layers, pixel_values_videos=pixels)
        with torch.no_grad():
            found[-1] = model.layernorm2(found[-1])
        space = [_grid(x.unflatten(0, (n, frames))) for x in found[:2]]
        return space + [_grid(x.unflatten(0, (n, -1)).transpose(1, 2)) for x in found[2:]]
    layers = model.encoder.layer if name == "timesformer" else model.layers
    found = [x[:, 1:] for x in outputs(model, layers, pixel_values=pixels)]
    with torch.no_grad():
        whole = model(pixel_values=pixels, output_hidden_states=True).hidden_states
    found[-1] = whole[-1][:, 1:]  # with or without the norm, as the library has it
    if name == "timesformer":  # places before moments
        return [_grid(x.unflatten(1, (-1, frames)).transpose(1, 2)) for x in found]
    return [_grid(x.unflatten(1, (frames // 2, -1))) for x in found]


def _grid(tokens):
    """``(n, t, places, k)`` as square maps."""
    side = int(tokens.shape[2] ** 0.5)
    return tokens.unflatten(2, (side, side)).permute(0, 1, 4, 2, 3)


@pytest.mark.parametrize("name", OF_TORCHVISION)
def test_a_network_of_torchvision_is_its_librarys_in_every_layer(name, tmp_path):
    frames = OF_TORCHVISION[name]
    torch.manual_seed(0)
    network = get_model_builder(KNOWN[name].door.partition(":")[2])(weights=None).eval()
    file = tmp_path / KNOWN[name].file
    torch.save(network.state_dict(), file)
    lock(file, None)
    encoder = load_encoder(name, {"resolution": 32, "frames": frames, "batch": 2}, tmp_path)
    usual = get_model_weights(KNOWN[name].door.partition(":")[2]).DEFAULT.transforms()
    assert encoder.look == Look(tuple(usual.mean), tuple(usual.std))

    def told(_, pixels):
        if hasattr(network, "features"):
            found = outputs(network.features, list(network.features), first(pixels))
        else:
            stages = [network.stem, *(getattr(network, f"layer{k}") for k in range(1, 5))]
            found = outputs(network, stages, pixels.transpose(1, 2))
        if name != "swin3d":
            return [x.transpose(1, 2) for x in found]
        found[-1] = network.norm(found[-1])
        return [x.permute(0, 1, 4, 2, 3) for x in found]

    def first(pixels):
        x = pixels.transpose(1, 2)
        return network.patch_embed(x) if name == "swin3d" else x

    with torch.no_grad():
        expect(encoder, name, told, clip(frames, 32, 32))


def test_tokens_of_mvit_are_maps_without_the_class_token():
    torch.manual_seed(0)
    blocks = [
        MSBlockConfig(heads, before, 32, [3, 3, 3], [3, 3, 3], stride, [1, 1, 1])
        for heads, before, stride in ((1, 16, [1, 1, 1]), (2, 32, [1, 1, 1]), (2, 32, [1, 2, 2]))
    ]
    flags = {"residual_pool": True, "residual_with_cls_embed": True, "rel_pos_embed": True}
    network = MViT((32, 32), 4, blocks, proj_after_attn=True, **flags).eval()
    none, settings = WeightsFile(Path("none"), "0" * 64), TorchvisionSettings(frames=4, batch=2)
    encoder = TorchvisionEncoder(network, settings, "mvit", none, Look(), 32)
    with torch.no_grad():
        sizes = [(2, 8, 8), (2, 8, 8), (2, 4, 4)]

        def told(_, pixels):
            found = outputs(network, network.blocks, pixels.transpose(1, 2))
            found[-1] = network.norm(found[-1])
            pairs = zip(found, sizes, strict=True)
            return [x[:, 1:].unflatten(1, size).permute(0, 1, 4, 2, 3) for x, size in pairs]

        expect(encoder, "mvit", told, clip(4, 32, 32))
    assert encoder(clip(4, 32, 32), TIMES[:4]).times.tolist() == [0.0, 0.08]
    with pytest.raises(ValueError, match="of 16 frames of 224 pixels; leave"):
        load_encoder("mvit", {"seed": 0, "frames": 8})


def test_layers_of_other_strides_stand_at_their_own_times():
    encoder = load_encoder("s3d", {"seed": 0, "resolution": 32})
    assert [encoder.at(layer).frames_per_feature for layer in ("1", "8", "14")] == [2, 4, 8]
    found = encoder.encode_layers(clip(16, 32, 32)[:1], TIMES, ("1", "14"))
    assert found["1"].times[:2].tolist() == [0.0, 0.08]
    assert found["14"].times.tolist() == pytest.approx([2 / 25, 10 / 25])


def test_thirty_encoders_have_names_and_each_of_a_door_is_held_to_its_library():
    opened = {name for name, known in KNOWN.items() if known.door}
    assert opened == {*OF_TIMM, *OF_HUB, *OF_TORCHVISION, "mvit"}
    assert opened <= set(ENCODERS.ours()) and len(ENCODERS.ours()) >= 30
    with pytest.raises(ValueError, match="unknown video network of torchvision 's3b'; did you"):
        load_encoder("torchvision:s3b", {})
