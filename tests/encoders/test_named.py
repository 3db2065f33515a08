"""Encoders behind a door that have a name here: held to their library's own hidden states.

Each is a small release in the official layout, of weights that its library drew. What is compared
with are the outputs of the library's own modules while it runs its own forward pass.
"""

from __future__ import annotations

import copy
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
from encoders.preprocess import LOOKS, Fitting, Look
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
OF_HUB["pe-video"] = lambda: hub.PeVideoEncoderConfig(
    hidden_size=32,
    intermediate_size=48,
    num_attention_heads=2,
    num_hidden_layers=2,
    head_dim=16,
    vision_config={
        "architecture": "vit_pe_core_small_patch16_384",
        "model_args": {"embed_dim": 32, "depth": 1, "num_heads": 2, "img_size": 32},
        "num_classes": 24,
    },
)
OF_TORCHVISION = {"s3d": 16, "r2plus1d": 8, "swin3d": 4}  # frames of a window
TIMES = torch.arange(16, dtype=torch.float64) / 25


def clip(frames, height, width):
    rng = torch.Generator().manual_seed(1)
    return torch.randint(256, (2, frames, 3, height, width), generator=rng, dtype=torch.uint8)


def shown(encoder, frames):
    """Pixels ``(n, f, 3, h, w)``, resized, cut and normalised by hand."""
    look, side = encoder.look, encoder.identity.resolution
    pixels, whole = frames.flatten(0, 1).float() / 255, encoder.fitting.whole(frames.shape[-2:])
    if pixels.shape[-2:] != whole:
        pixels = functional.interpolate(pixels, whole, mode=look.mode, antialias=True).clamp(0, 1)
    if encoder.fitting.fit == "crop":
        top, left = ((length - side) // 2 for length in whole)
        pixels = pixels[..., top : top + side, left : left + side]
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


def expect(load, told, frames, side, more=()):
    """Hold every layer to what the library says of the same pixels.

    Of square pictures, and of wide ones that are squashed, cut, and shown as the encoder shows them
    by itself; in passes of other sizes; and in bfloat16, which is near and not the same.

    Args:
        load: the encoder with some options.
        told: the library's states of pixels ``(n, f, 3, h, w)``, one layer after the other.
        frames: of a window.
        side: pixels that the network is made for.
        more: options under which wide pictures are held to the library, too.
    """
    wide, times = clip(frames, side, 2 * side), TIMES[:frames]
    shapes = [(clip(frames, side, side), {}), *((wide, {"fit": fit}) for fit in ("squash", "crop"))]
    for clips, options in (*shapes, *((wide, options) for options in more), (wide, {})):
        encoder = load(batch=2, **options)
        found = encoder.encode_layers(clips, times, encoder.layers)
        states = told(shown(encoder, clips))
        assert len(states) == len(encoder.layers)
        for layer, state in zip(encoder.layers, states, strict=True):
            assert found[layer].values.shape == state.shape, (options, layer)
            torch.testing.assert_close(found[layer].values, state, atol=2e-4, rtol=1e-3)
        for early, late in zip(states, states[1:], strict=False):  # or it shows nothing
            assert early.shape != late.shape or (early - late).norm() > 1e-4 * late.norm()
    for batch in (1, 3):
        other = load(batch=batch).encode_layers(wide, times, encoder.layers)
        for layer, maps in found.items():
            torch.testing.assert_close(other[layer].values, maps.values, atol=1e-4, rtol=1e-3)
    # of one clip, as many processors count in bfloat16 at a fiftieth of their speed
    short = load(batch=2, dtype="bfloat16").encode_layers(wide[:1], times, encoder.layers)
    for layer, maps in found.items():
        of_one = maps.values[:1]
        off = float((short[layer].values - of_one).norm() / of_one.norm())
        assert 1e-5 < off < 0.05, (layer, off)


def release_of_timm(name, folder):
    arch = KNOWN[name].door.partition(":")[2]
    torch.manual_seed(0)
    made = {"pretrained": False, "num_classes": 0, **OF_TIMM[name]}
    if "img_size" in made:  # it takes others too
        made["dynamic_img_size"] = True
    network = timm.create_model(arch, **made).eval()
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
        grid = [pixels.shape[-2 + k] // network.patch_embed.patch_size[k] for k in (0, 1)]
        states = [x.unflatten(1, grid).permute(0, 3, 1, 2) for x in states]
    return [x.unflatten(0, pixels.shape[:2]) for x in states]


@pytest.mark.parametrize("name", OF_TIMM)
def test_an_image_encoder_is_its_librarys_in_every_layer(name, tmp_path):
    network = release_of_timm(name, tmp_path)
    side = OF_TIMM[name].get("img_size", 64)
    encoder = load_encoder(name, {"resolution": side}, tmp_path)
    assert encoder.identity.name == name

    def load(resolution=side, **options):
        return load_encoder(name, {"resolution": resolution, **options}, tmp_path)

    assert encoder.fitting.fit == "keep"  # of any shape, and of other sizes than its own
    larger = {"resolution": side + 2 * encoder.fitting.multiple}
    expect(load, lambda x: states_of_timm(network, x), 2, side, [larger])


@pytest.mark.parametrize("name", OF_HUB)
def test_a_video_encoder_is_its_librarys_in_every_layer(name, tmp_path):
    torch.manual_seed(0)
    model = hub.AutoModel.from_config(OF_HUB[name]()).eval()
    model.save_pretrained(tmp_path / name)
    lock(tmp_path / name, None)
    encoder = load_encoder(name, {}, tmp_path)
    assert encoder.look == LOOKS[KNOWN[name].look] and encoder.identity.resolution == 32

    def load(**options):
        return load_encoder(name, options, tmp_path)

    def told(pixels):
        return states_of_hub(name, getattr(model, "vision_model", model), pixels)

    expect(load, told, 16 if name == "pe-video" else 4, 32)


def test_other_windows_and_sizes_are_those_of_a_model_that_is_made_for_them(tmp_path):
    torch.manual_seed(0)
    small = hub.AutoModel.from_config(OF_HUB["timesformer"]()).eval()
    small.save_pretrained(tmp_path / "timesformer")
    lock(tmp_path / "timesformer", None)
    told = OF_HUB["timesformer"]()
    told.num_frames, told.image_size = 8, 48
    large, state = hub.AutoModel.from_config(told).eval(), small.state_dict()
    times = functional.interpolate(state["embeddings.time_embeddings"].mT, 8).mT
    table = state["embeddings.position_embeddings"]
    places = table[:, 1:].mT.unflatten(2, (4, 4))
    places = functional.interpolate(places, (6, 6)).flatten(2).mT  # each cell its nearest
    state["embeddings.time_embeddings"] = times
    state["embeddings.position_embeddings"] = torch.cat([table[:, :1], places], 1)
    large.load_state_dict(state)
    encoder = load_encoder("timesformer", {"frames": 8, "resolution": 48}, tmp_path)
    assert encoder.windowing.frames == 8 and encoder.identity.resolution == 48
    frames = clip(8, 48, 48)
    found = encoder.encode_layers(frames, TIMES[:8], encoder.layers)
    states = states_of_hub("timesformer", large, shown(encoder, frames))
    for layer, expected in zip(encoder.layers, states, strict=True):
        torch.testing.assert_close(found[layer].values, expected, atol=2e-4, rtol=1e-3)


def test_frames_that_send_messages_are_told_how_many_they_are(tmp_path):
    torch.manual_seed(0)
    small = hub.AutoModel.from_config(OF_HUB["xclip"]()).eval()
    small.save_pretrained(tmp_path / "xclip")
    lock(tmp_path / "xclip", None)
    told = OF_HUB["xclip"]()
    told.vision_config.num_frames = 8
    large = hub.AutoModel.from_config(told).eval().vision_model
    large.load_state_dict(small.vision_model.state_dict())
    encoder = load_encoder("xclip", {"frames": 8}, tmp_path)
    frames = clip(8, 32, 32)
    found = encoder.encode_layers(frames, TIMES[:8], encoder.layers)
    states = states_of_hub("xclip", large, shown(encoder, frames))
    for layer, expected in zip(encoder.layers, states, strict=True):
        torch.testing.assert_close(found[layer].values, expected, atol=2e-4, rtol=1e-3)


@pytest.mark.parametrize(
    ("name", "options"), [("vivit", {"resolution": 48}), ("vivit", {"frames": 8})]
)
def test_a_size_or_a_window_that_the_library_does_not_let_it_take_is_refused(
    name, options, tmp_path
):
    hub.AutoModel.from_config(OF_HUB[name]()).save_pretrained(tmp_path / name)
    lock(tmp_path / name, None)
    with pytest.raises(ValueError, match=f"{name}: its library does not let it take .* leave"):
        load_encoder(name, options, tmp_path)


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
    if name == "pe-video":
        found = outputs(model, model.layers, pixel_values_videos=pixels)
        with torch.no_grad():
            found[-1] = torch.cat([found[-1][:, :1], model(pixels).last_hidden_state], 1)
        return [x[:, 1:, :, None, None] for x in found]
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


@pytest.mark.parametrize(
    "name", ["swin3d", *(pytest.param(x, marks=pytest.mark.slow) for x in ("s3d", "r2plus1d"))]
)
def test_a_network_of_torchvision_is_its_librarys_in_every_layer(name, tmp_path):
    frames = OF_TORCHVISION[name]
    torch.manual_seed(0)
    network = get_model_builder(KNOWN[name].door.partition(":")[2])(weights=None).eval()
    file = tmp_path / KNOWN[name].file
    torch.save(network.state_dict(), file)
    lock(file, None)
    encoder = load_encoder(name, {"resolution": 32, "frames": frames}, tmp_path)
    usual = get_model_weights(KNOWN[name].door.partition(":")[2]).DEFAULT.transforms()
    assert encoder.look == Look(tuple(usual.mean), tuple(usual.std))

    def told(pixels):
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
        expect(loader(encoder.network, name, frames, encoder.look), told, frames, 32)


def loader(network, name, frames, look):
    """Makes encoders over a network of torchvision, of 32 pixels."""
    none = WeightsFile(Path("none"), "0" * 64)

    def load(fit="squash", dtype="float32", **options):
        own = copy.deepcopy(network) if dtype == "bfloat16" else network
        settings = TorchvisionSettings(frames=frames, fit=fit, dtype=dtype, **options)
        return TorchvisionEncoder(own, settings, name, none, look, Fitting(fit, 32, before=40))

    return load


def test_tokens_of_mvit_are_maps_without_the_class_token():
    torch.manual_seed(0)
    blocks = [
        MSBlockConfig(heads, before, 32, [3, 3, 3], [3, 3, 3], stride, [1, 1, 1])
        for heads, before, stride in ((1, 16, [1, 1, 1]), (2, 32, [1, 1, 1]), (2, 32, [1, 2, 2]))
    ]
    flags = {"residual_pool": True, "residual_with_cls_embed": True, "rel_pos_embed": True}
    network = MViT((32, 32), 4, blocks, proj_after_attn=True, **flags).eval()
    load = loader(network, "mvit", 4, Look())
    with torch.no_grad():
        sizes = [(2, 8, 8), (2, 8, 8), (2, 4, 4)]

        def told(pixels):
            found = outputs(network, network.blocks, pixels.transpose(1, 2))
            found[-1] = network.norm(found[-1])
            pairs = zip(found, sizes, strict=True)
            return [x[:, 1:].unflatten(1, size).permute(0, 1, 4, 2, 3) for x, size in pairs]

        expect(load, told, 4, 32)
    assert load()(clip(4, 32, 32), TIMES[:4]).times.tolist() == [0.0, 0.08]
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
