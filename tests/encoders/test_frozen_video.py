"""DINOv2, VideoMAE, V-JEPA 2 and I3D: tiny checkpoints in the official layout, and the real I3D."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional

from encoders import weights as weights_module
from encoders.frozen import (
    ENCODERS,
    FrozenEncoder,
    I3DEncoder,
    I3DSettings,
    load_encoder,
    load_i3d,
)
from encoders.frozen.i3d_network import STAGES, I3DNetwork, field_centre, field_stride, pool
from encoders.frozen.windows import Windowing, feature_times, windows
from encoders.known_weights import KNOWN
from encoders.release import WeightsFile, WeightsMissing, release_sha256
from encoders.weights import fetch, find_weights, lock
from tests.shared.layers import expect_layers
from vidphys.cli.extract import ExtractConfig, extract
from vidphys.cli.weights import WeightsConfig, weights
from vidphys.errors import InputError

I3D_FILE = KNOWN["i3d"].file
TINY_VIT = {"embed_dim": 32, "depth": 3, "num_heads": 2, "img_size": 70, "init_values": 1.0}
TINY_VIDEOMAE = {
    "image_size": 32,
    "patch_size": 8,
    "num_frames": 4,
    "hidden_size": 24,
    "num_hidden_layers": 3,
    "num_attention_heads": 2,
    "intermediate_size": 48,
    "decoder_hidden_size": 12,
    "decoder_num_hidden_layers": 1,
    "decoder_num_attention_heads": 2,
    "decoder_intermediate_size": 24,
}
TINY_VJEPA2 = {
    "patch_size": 8,
    "crop_size": 32,
    "frames_per_clip": 8,
    "hidden_size": 32,
    "num_hidden_layers": 3,
    "num_attention_heads": 2,
    "pred_hidden_size": 32,
    "pred_num_hidden_layers": 2,
    "pred_num_attention_heads": 2,
}
# options under which every tiny encoder is quick, and the library's own view of the same network
QUICK: dict[str, dict[str, Any]] = {
    "dinov2-small": {"resolution": 42, "batch": 3},
    "videomae-small": {},
    "videomae-base": {"batch": 2},
    "vjepa2-l": {"resolution": 32, "frames": 4, "batch": 2},
    "i3d": {"layer": "Mixed_3b", "resolution": 32, "frames": 8, "batch": 2},
}
TRANSFORMERS = ("dinov2-small", "videomae-small", "videomae-base", "vjepa2-l")


def patterned(module: nn.Module) -> nn.Module:
    """The module with weights that depend on no random number generator."""
    for number, (key, value) in enumerate(module.state_dict().items()):
        if not value.is_floating_point():
            continue
        wave = torch.sin(torch.arange(value.numel()) * 0.7 + number).reshape(value.shape)
        positive = "norm" in key or "gamma" in key or "bn." in key
        if positive and (key.endswith(("weight", "gamma", "running_var"))):
            value.copy_(1 + 0.1 * wave)
        else:
            value.copy_(1.5 * wave / max(value[0].numel(), 4) ** 0.5)
    return module


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A weights folder with a tiny release of every architecture, all locked."""
    from timm.models import create_model
    from timm.models._hub import save_for_hf
    from transformers import (
        VideoMAEConfig,
        VideoMAEForPreTraining,
        VideoMAEForVideoClassification,
        VJEPA2Config,
        VJEPA2Model,
    )

    path = tmp_path_factory.mktemp("weights")
    vit = patterned(create_model("vit_small_patch14_dinov2", num_classes=0, **TINY_VIT))
    save_for_hf(vit, str(path / "dinov2-small"), model_args=TINY_VIT, safe_serialization=True)
    classifier = VideoMAEForVideoClassification(
        VideoMAEConfig(**TINY_VIDEOMAE, use_mean_pooling=True)
    )
    patterned(classifier).save_pretrained(path / "videomae-small")
    masked = VideoMAEForPreTraining(VideoMAEConfig(**TINY_VIDEOMAE, use_mean_pooling=False))
    patterned(masked).save_pretrained(path / "videomae-base")
    jepa = patterned(VJEPA2Model(VJEPA2Config(**TINY_VJEPA2)))
    jepa.save_pretrained(path / "vjepa2-l", max_shard_size="100KB")
    i3d = patterned(I3DNetwork()).half().state_dict()
    i3d["logits.conv3d.bias"] = torch.zeros(400)
    save_file(i3d, path / I3D_FILE)
    for entry in [*TRANSFORMERS, I3D_FILE]:
        lock(path / entry, "c0ffee")
    return path


@pytest.fixture(scope="module")
def encoders(folder: Path) -> dict[str, FrozenEncoder]:
    return {name: load_encoder(name, options, folder) for name, options in QUICK.items()}


@pytest.fixture(params=list(QUICK))
def encoder(request: pytest.FixtureRequest, encoders: dict[str, FrozenEncoder]) -> FrozenEncoder:
    return encoders[request.param]


def frames(count: int, height: int = 20, width: int = 20, clips: int = 1) -> Tensor:
    return torch.rand(clips, count, 3, height, width)


def times(count: int) -> Tensor:
    return torch.arange(count, dtype=torch.float64) * 0.1


def library_states(name: str, folder: Path, pixels: Tensor) -> tuple[list[Tensor], Tensor]:
    """Hidden states of the library's own model from the same folder, and its last one."""
    from timm.models import create_model
    from transformers import VideoMAEModel, VJEPA2Model

    if name == "dinov2-small":
        arguments = {**TINY_VIT, "dynamic_img_size": True}
        vit = create_model("vit_small_patch14_dinov2", num_classes=0, **arguments).eval()
        vit.load_state_dict(load_file(folder / name / "model.safetensors"))
        with torch.no_grad():
            states = vit.forward_intermediates(pixels[0], output_fmt="NLC")[1]
            return states, vit.forward_features(pixels[0])[:, 1:]
    model_type = VJEPA2Model if name == "vjepa2-l" else VideoMAEModel
    model = model_type.from_pretrained(folder / name).eval()
    with torch.no_grad():
        found = model(pixels, output_hidden_states=True)
    return list(found.hidden_states[1:]), found.last_hidden_state


@pytest.mark.parametrize("name", TRANSFORMERS)
def test_equals_the_library_and_stops_at_the_layer(name: str, folder: Path) -> None:
    """Against hidden states of a whole forward pass, with the library's own loading."""
    side = 42 if name == "dinov2-small" else 32
    clip = frames(4, side, side)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    pixels = (clip - mean[:, None, None]) / std[:, None, None]
    states, last = library_states(name, folder, pixels)
    for layer in (1, 2, 3):
        encoder = load_encoder(name, {**QUICK[name], "layer": layer}, folder)
        ran: list[int] = []
        for key, module in encoder.network.named_modules():
            parts = key.split(".")
            if parts[-1].isdigit() and parts[-2] in ("blocks", "layer"):
                module.register_forward_hook(lambda *_, k=int(parts[-1]), r=ran: r.append(k))
        got = encoder(clip, times(4)).values
        assert sorted(set(ran)) == list(range(layer))
        tokens = got[0].flatten(2).transpose(1, 2)
        expected = last if layer == 3 else states[layer - 1]
        torch.testing.assert_close(
            tokens.flatten(0, 1), expected.flatten(0, 1), rtol=1e-4, atol=1e-5
        )
        # a block changes what is read, or the comparison shows nothing
        assert (states[layer - 1] - states[layer - 2]).abs().mean() > 0.01


@pytest.mark.parametrize("name", [*QUICK, "predictor"])
def test_all_layers_in_one_pass(name: str, folder: Path) -> None:
    asked = {"vjepa2-l": {**QUICK["vjepa2-l"], "predictor": True}} if name == "predictor" else QUICK
    name = "vjepa2-l" if name == "predictor" else name
    options = {key: value for key, value in asked[name].items() if key != "layer"}

    def alone(layer: str) -> FrozenEncoder:
        if layer == "predictor":
            return load_encoder(name, options, folder)
        plain = {key: value for key, value in options.items() if key != "predictor"}
        return load_encoder(name, {**plain, "layer": layer}, folder)

    # I3D continues the edges by a cell, and strides in time: five kinds of windows
    passes = 5 if name == "i3d" else 3 if name == "dinov2-small" else 1
    encoder = load_encoder(name, options, folder)
    expect_layers(encoder, alone, frames(7 if encoder.windowing.frames == 1 else 4), passes)


def test_predictor_only_where_it_is_asked_for(folder: Path) -> None:
    from transformers import VJEPA2Model

    plain = load_encoder("vjepa2-l", QUICK["vjepa2-l"], folder)
    assert not any("predictor" in key for key in plain.network.state_dict())
    asked = load_encoder("vjepa2-l", {**QUICK["vjepa2-l"], "predictor": True}, folder)
    assert asked.identity.layer == "predictor"
    clip = frames(4, 32, 32)
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    model = VJEPA2Model.from_pretrained(folder / "vjepa2-l").eval()
    with torch.no_grad():
        whole = model((clip - mean[:, None, None]) / std[:, None, None])
    tokens = asked(clip, times(4)).values[0].flatten(2).transpose(1, 2).flatten(0, 1)
    expected = whole.predictor_output.last_hidden_state[0]
    torch.testing.assert_close(tokens, expected, rtol=1e-4, atol=1e-5)
    with pytest.raises(ValueError, match="takes square frames, got 16 x 20"):
        asked(frames(4, 16, 20), times(4))
    with pytest.raises(ValueError, match="leave out layer"):
        load_encoder("vjepa2-l", {"resolution": 32, "predictor": True, "layer": 2}, folder)


def test_positions_of_a_wide_image_are_those_of_the_square(folder: Path) -> None:
    """A token's position is its row and column, whatever the shape of the image."""
    encoder = load_encoder("vjepa2-l", {**QUICK["vjepa2-l"], "layer": 1}, folder)
    ids = []
    attention = encoder.network["encoder"].layer[0].attention  # type: ignore[index]
    attention.get_position_ids_ = attention.get_position_ids
    attention.get_position_ids = lambda x, masks: (
        ids.append(attention.get_position_ids_(x, masks)) or ids[-1]
    )
    values = encoder(frames(4, 16, 32), times(4)).values
    assert values.shape == (1, 2, 32, 2, 4)
    t, y, x = (axis[0, 0] for axis in ids[0])
    assert t.tolist() == [0] * 8 + [1] * 8
    assert y.tolist() == ([0] * 4 + [1] * 4) * 2
    assert x.tolist() == [0, 1, 2, 3] * 4


GOLDEN = {
    "dinov2-small": ((2, 32, 3, 3), (1.330269, -0.112329, 1.158620)),
    "videomae-small": ((1, 24, 4, 4), (7.254526, 0.068654, 5.664945)),
    "videomae-base": ((1, 24, 4, 4), (0.393926, 0.070429, 1.050998)),
    "vjepa2-l": ((1, 32, 4, 4), (1.390739, -1.865966, 1.137410)),
    "i3d": ((1, 256, 4, 4), (3.220570, 1.323997, 1.976196)),
}


@pytest.mark.parametrize("name", QUICK)
def test_golden(name: str, encoders: dict[str, FrozenEncoder]) -> None:
    """Numbers written down from torch 2.15, transformers 5.23, timm 1.0.31; no generator."""
    ramp = torch.linspace(0, 1, 32)
    image = torch.stack([ramp.expand(32, 32), ramp[:, None].expand(32, 32), ramp.outer(ramp)])
    clip = torch.stack([image, image.flip(-1)])[None]
    values = encoders[name](clip, times(2)).values[0]
    shape, numbers = GOLDEN[name]
    assert values.shape == shape
    got = (values[0, 0, 0, 0], values[-1, 6, 1, 2], values.std())
    assert [float(v) for v in got] == pytest.approx(numbers, rel=2e-3, abs=2e-4)


def test_a_clip_has_the_same_features_in_any_company(encoder: FrozenEncoder) -> None:
    clips = frames(9, clips=3)
    sizes: set[tuple[int, ...]] = set()
    original = encoder.encode
    encoder.encode = lambda x, layers: sizes.add(tuple(x.shape)) or original(x, layers)  # type: ignore[method-assign,func-returns-value]
    together = encoder(clips, times(9)).values
    for k in range(3):
        assert torch.equal(encoder(clips[k : k + 1], times(9)).values[0], together[k])
    del encoder.encode  # type: ignore[method-assign]
    assert len(sizes) == 1 and next(iter(sizes))[0] == encoder.batch
    assert not torch.equal(together[0], together[1])


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 13])
def test_any_number_of_frames(encoder: FrozenEncoder, count: int) -> None:
    clip, step = frames(count), encoder.windowing.tubelet
    found = encoder(clip, times(count))
    assert found.values.shape[1] == len(found.times) == -(-count // step)
    assert torch.isfinite(found.values).all()
    assert found.times.dtype == torch.float64
    assert bool((found.times.diff() > 0).all())
    assert float(found.times[0]) >= 0 and float(found.times[-1]) <= float(times(count)[-1])
    # a window of a long clip has the features that it has as a clip of its own
    length = encoder.windowing.frames
    if count >= length and length % step == 0:
        alone = encoder(clip[:, :length], times(length)).values
        kept = windows(count, encoder.windowing)[0].kept
        assert torch.equal(found.values[:, : len(kept)], alone[:, : len(kept)])


@pytest.mark.parametrize("count", [1, 5, 13])
def test_a_clip_that_streams_in_has_the_features_of_a_whole_one(
    encoder: FrozenEncoder, count: int
) -> None:
    bytes_ = (255 * frames(count)[0]).round().to(torch.uint8)
    pictures = bytes_.permute(0, 2, 3, 1).contiguous()  # as they are decoded
    whole = encoder(pictures.permute(0, 3, 1, 2)[None], times(count))
    said: list[tuple[int, int]] = []
    size, layer = (bytes_.shape[-2], bytes_.shape[-1]), encoder.identity.layer

    def told(done: int, of: int) -> None:
        said.append((done, of))

    def blocks() -> Iterator[Tensor]:
        return (block.permute(0, 3, 1, 2) for block in pictures.split(3))

    (stream,) = encoder.stream(blocks, size, times(count), [layer], told)
    found = stream.whole()[layer]
    assert torch.equal(found.values, whole.values) and found.stride == whole.stride
    assert torch.equal(found.times, whole.times) and not found.values.is_inference()
    assert said[-1] == (count, count)
    with pytest.raises(ValueError, match="needs at least one frame"):
        next(encoder.stream(blocks, size, times(0), [layer]))
    (short,) = encoder.stream(lambda: [bytes_[:0]], size, times(count), [layer])
    with pytest.raises(ValueError, match="0 frames came in, more than"):
        short.whole()


def test_layers_stream_together(encoder: FrozenEncoder) -> None:
    clip = (255 * frames(9)).round().to(torch.uint8)
    whole = encoder.encode_layers(clip, times(9), encoder.layers)
    said: list[int] = []
    streams = encoder.stream(
        lambda: clip[0].split(4),
        (clip.shape[-2], clip.shape[-1]),
        times(9),
        encoder.layers,
        lambda done, of: said.append(done),
    )
    found = {layer: each for stream in streams for layer, each in stream.whole().items()}
    assert set(found) == set(whole) and said == sorted(said) and said[-1] == 9
    for layer, each in found.items():
        assert torch.equal(each.values, whole[layer].values)
        assert torch.equal(each.times, whole[layer].times) and each.stride == whole[layer].stride


@pytest.mark.parametrize("name", ["videomae-base", "vjepa2-l"])
def test_short_and_odd_clips_are_continued_with_their_last_frame(
    name: str, encoders: dict[str, FrozenEncoder]
) -> None:
    clip = frames(3)
    longer = torch.cat([clip, clip[:, -1:]], 1)
    three = encoders[name](clip, times(3))
    assert torch.equal(three.values, encoders[name](longer, times(4)).values)
    torch.testing.assert_close(three.times, torch.tensor([0.05, 0.2], dtype=torch.float64))
    still = encoders[name](clip[:, :1], times(1))
    assert still.values.shape[1] == 1 and float(still.times[0]) == 0


def test_times_are_the_centre_of_what_was_seen(encoders: dict[str, FrozenEncoder]) -> None:
    uneven = torch.tensor([0.0, 0.1, 0.4, 0.5, 2.0], dtype=torch.float64)
    found = encoders["vjepa2-l"](frames(5), uneven).times
    torch.testing.assert_close(found, torch.tensor([0.05, 0.45, 2.0], dtype=torch.float64))
    assert torch.equal(encoders["dinov2-small"](frames(5), uneven).times, uneven)
    found = encoders["i3d"](frames(5), uneven).times  # Mixed_3b: fields centred on frames 1, 3, 5
    torch.testing.assert_close(found, torch.tensor([0.1, 0.5, 2.0], dtype=torch.float64))


@pytest.mark.parametrize("name", QUICK)
def test_frame_stride_is_a_clip_with_fewer_frames(name: str, folder: Path) -> None:
    clip = frames(8)
    strided = load_encoder(name, {**QUICK[name], "frame_stride": 2}, folder)
    plain = load_encoder(name, QUICK[name], folder)
    found, expected = strided(clip, times(8)), plain(clip[:, ::2], times(8)[::2])
    assert torch.equal(found.values, expected.values)
    assert torch.equal(found.times, expected.times)
    assert strided.identity != plain.identity


def test_i3d_shown_each_frame_twice_gives_a_feature_frame_for_each(folder: Path) -> None:
    clip = frames(6)
    slow, plain = (
        load_encoder("i3d", {**QUICK["i3d"], "layer": "Conv3d_2c_3x3", **more}, folder)
        for more in ({"frames": 6, "shown": 2}, {"frames": 12})
    )
    found = slow(clip, times(6))
    twice = plain(clip.repeat_interleave(2, 1), times(12))
    assert torch.equal(found.values, twice.values)
    # a copy lasts half as long: its middle is a quarter of a frame from the frame's own
    torch.testing.assert_close(found.times[:-1], twice.times[:-1] / 2 - 0.025)
    assert slow.frames_per_feature == 1
    assert slow.identity != plain.identity


def test_overlapping_windows_give_each_feature_more_context(folder: Path) -> None:
    options = {**QUICK["vjepa2-l"], "frames": 8}
    clip = frames(12)
    encoder = load_encoder("vjepa2-l", {**options, "hop": 2}, folder)
    found = encoder(clip, times(12)).values
    middle = encoder(clip[:, 2:10], times(8)).values
    assert torch.equal(found[:, 3], middle[:, 2])  # of windows at 0, 2 and 4 the middle one
    first = encoder(clip[:, :8], times(8)).values
    assert torch.equal(found[:, 2], first[:, 2])  # as central in two windows: the earlier one
    assert encoder.identity != load_encoder("vjepa2-l", options, folder).identity


@given(st.integers(1, 70), st.integers(1, 8), st.integers(1, 6), st.data(), st.booleans())
def test_windows_cover_a_clip_once(
    count: int, tubelet: int, length: int, data: st.DataObject, shortens: bool
) -> None:
    step = data.draw(st.integers(1, length))
    windowing = Windowing(length * tubelet, step * tubelet, tubelet, shortens=shortens)
    plan = windows(count, windowing)
    features = -(-count // tubelet)
    covered = [w.frames[0] // tubelet + k for w in plan for k in w.kept]
    assert covered == list(range(features))
    for window in plan:
        assert window.frames[0] % tubelet == 0
        assert max(window.frames) <= count - 1
        copies = len(window.frames) - len(set(window.frames))
        assert copies < tubelet or (count < length * tubelet and not shortens)
        assert len(window.frames) == len(plan[0].frames) <= length * tubelet
    assert len(feature_times(times(count), windowing)) == features


def test_bytes_are_floats(encoder: FrozenEncoder) -> None:
    stored = torch.randint(0, 256, (1, 3, 3, 20, 20), dtype=torch.uint8)
    expected = encoder(stored.float() / 255, times(3)).values
    assert torch.equal(encoder(stored, times(3)).values, expected)


def test_grid_and_channels(encoder: FrozenEncoder) -> None:
    found = encoder(frames(2, 18, 30), times(2))
    h, w = found.grid
    assert (h * found.stride[0], w * found.stride[1]) == pytest.approx((18, 30))
    grey = torch.rand(1, 2, 1, 20, 20)
    expected = encoder(grey.expand(-1, -1, 3, -1, -1), times(2)).values
    assert torch.equal(encoder(grey, times(2)).values, expected)
    assert not expected.requires_grad and not expected.is_inference()


def test_bad_frames(encoder: FrozenEncoder, unchecked: None) -> None:
    for clip, count, message in [
        (frames(3)[:, :0], 0, "needs at least one frame"),
        (frames(3), 2, "3 frames have 2 times"),
        (frames(3) * 255, 3, r"values in \[0, 1\], got .* to 25.*; divide bytes by 255"),
        (frames(3).index_fill(1, torch.tensor(1), float("nan")), 3, "must be finite"),
        (frames(3).index_fill(1, torch.tensor(1), float("inf")), 3, "must be finite"),
    ]:
        with pytest.raises(ValueError, match=message) as caught:
            encoder(clip, times(count))
        assert str(caught.value).startswith(encoder.identity.name)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("dinov2-small", {"layer": 4}, "dinov2-small: no layer 4; it has 1 to 3"),
        ("dinov2-small", {"resolution": 100}, "multiple of 14; the nearest is 98"),
        ("dinov2-small", {"frames": 4}, "takes no frames; it takes layer, resolution"),
        ("dinov2-small", {"batch": 0}, "batch 0: must be at least 1"),
        ("videomae-base", {"layer": "Mixed_4f"}, "no layer 'Mixed_4f'; it has 1 to 3"),
        ("videomae-base", {"resolution": 64}, "takes no resolution"),
        ("videomae-base", {"hop": 3}, "hop 3 must be a multiple of 2, 2 to 4 frames"),
        ("videomae-base", {"hop": 0}, "hop 0 must be"),
        ("videomae-base", {"frame_stride": 0}, "frame_stride 0: must be at least 1"),
        ("vjepa2-l", {"frames": 5}, "windows of 5 frames do not fit tubelets of 2"),
        ("vjepa2-l", {"layer": 0}, "no layer 0"),
        ("i3d", {"layer": "Mixed_9"}, "no layer 'Mixed_9'; it has Conv3d_1a_7x7, "),
        ("i3d", {"resolution": 48}, "multiple of 32"),
        ("i3d", {"frames": 6}, "windows of 6 frames do not fit tubelets of 4"),
        ("i3d", {"shown": 3}, "Mixed_4f strides over 4 frames, so that each can be shown 1 to 4 "),
        ("i3d", {"shown": 0}, "a number that divides it; got 0"),
        ("i3", {}, "unknown encoder 'i3'; did you mean 'i3d'"),
    ],
)
def test_bad_settings(
    folder: Path, unchecked: None, name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        load_encoder(name, options, folder)
    assert "\n" not in str(caught.value)


def test_every_known_set_of_weights_has_an_encoder() -> None:
    assert set(ENCODERS.ours()) == set(KNOWN)


def copy_release(folder: Path, name: str, target: Path) -> Path:
    (target / name).mkdir(parents=True)
    for file in (folder / name).iterdir():
        (target / name / file.name).write_bytes(file.read_bytes())
    return target / name


def drop(tensors: dict[str, Tensor]) -> None:
    del tensors[next(key for key in tensors if "1.mlp" in key or "1.output" in key)]


def add(tensors: dict[str, Tensor]) -> None:
    tensors["extra"] = torch.ones(1)


def reshape(tensors: dict[str, Tensor]) -> None:
    key = next(key for key in tensors if key.endswith(("blocks.0.norm1.bias", "e.layernorm.bias")))
    tensors[key] = tensors[key][1:].clone()


@pytest.mark.parametrize("name", ["dinov2-small", "videomae-base"])
@pytest.mark.parametrize(
    ("spoil", "message"),
    [(drop, "1 keys missing"), (add, "1 unknown .*extra"), (reshape, "has shape")],
)
def test_loading_is_strict(
    folder: Path, tmp_path: Path, name: str, spoil: Callable[[dict], None], message: str
) -> None:
    release = copy_release(folder, name, tmp_path)
    tensors = load_file(release / "model.safetensors")
    spoil(tensors)
    save_file(tensors, release / "model.safetensors")
    lock(release, None)
    with pytest.raises(ValueError, match=message):
        load_encoder(name, {}, tmp_path)


@pytest.mark.parametrize("name", [*TRANSFORMERS, "i3d"])
def test_every_tensor_is_loaded(
    name: str, folder: Path, encoders: dict[str, FrozenEncoder]
) -> None:
    loaded = encoders[name].network.state_dict()
    place = folder / KNOWN[name].file
    files = [place] if place.is_file() else sorted(place.glob("*.safetensors"))
    saved = {k.removeprefix("videomae."): v for f in files for k, v in load_file(f).items()}
    for key, value in loaded.items():
        if name.startswith("videomae"):
            key = key.replace(".query.bias", ".q_bias").replace(".value.bias", ".v_bias")
        assert torch.equal(value, saved[key].to(value.dtype)), key


def test_a_release_folder_is_checked_as_a_whole(folder: Path, tmp_path: Path) -> None:
    release = copy_release(folder, "vjepa2-l", tmp_path)
    assert release_sha256(release) == release_sha256(folder / "vjepa2-l")
    locked = "expected one that was locked; .*check vjepa2-l` with `lock`"
    with pytest.raises(ValueError, match=locked):
        find_weights("vjepa2-l", tmp_path)
    lock(release, None)
    for where in (tmp_path, release):
        assert find_weights("vjepa2-l", where).path == release
    shard = sorted(release.glob("model-*"))[1]
    content = shard.read_bytes()
    shard.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    with pytest.raises(ValueError, match="damaged or another release"):
        find_weights("vjepa2-l", tmp_path)
    shard.unlink()
    with pytest.raises(WeightsMissing, match=f"has no {shard.name}; a release folder holds"):
        find_weights("vjepa2-l", tmp_path)


def test_another_model_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "videomae-base").mkdir()
    release = copy_release(folder, "vjepa2-l", tmp_path / "videomae-base")
    release.rename(tmp_path / "moved")
    lock(tmp_path / "moved", None)
    with pytest.raises(ValueError, match="has model_type 'vjepa2', expected 'videomae'"):
        load_encoder("videomae-base", {}, tmp_path / "moved")
    (tmp_path / "moved" / "config.json").write_text("{")
    lock(tmp_path / "moved", None)
    with pytest.raises(ValueError, match=r"config\.json is not JSON"):
        load_encoder("videomae-base", {}, tmp_path / "moved")
    (tmp_path / "moved" / "config.json").unlink()
    with pytest.raises(WeightsMissing, match=r"no folder .*videomae-base; get it by"):
        load_encoder("videomae-base", {}, tmp_path / "elsewhere")


@pytest.mark.parametrize("name", ["vjepa2-l", "dinov2-small"])
def test_fetch_copies_a_release_and_pins_it(
    name: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def from_hub(repository: str, file: str, revision: str | None) -> tuple[Path, str]:
        asked.append((repository, file, revision))
        if not (folder / name / file).is_file():
            raise FileNotFoundError(f"{repository} has no {file}")
        return folder / name / file, revision or "c0ffee"

    monkeypatch.setattr(weights_module, "from_hub", from_hub)
    found = fetch(name, tmp_path)
    assert found.sha256 == release_sha256(folder / name)
    assert asked[0] == (KNOWN[name].hub, "config.json", None)
    assert {revision for _, _, revision in asked[1:]} == {"c0ffee"}
    assert load_encoder(name, QUICK[name], tmp_path).identity.weights_sha256 == found.sha256
    assert json.loads((tmp_path / f"{name}.lock.json").read_text())["revision"] == "c0ffee"
    asked.clear()
    fetch(name, tmp_path)
    assert not asked  # it is here
    (tmp_path / name / "config.json").unlink()
    fetch(name, tmp_path)  # the second time at the commit of the first
    assert asked[0][2] == "c0ffee"
    monkeypatch.setattr(
        weights_module, "from_hub", lambda *_: (_ for _ in ()).throw(FileNotFoundError("no x"))
    )
    (tmp_path / name / "config.json").unlink()
    with pytest.raises(InputError, match=f"no x.*check {name} --lock"):
        weights(WeightsConfig("fetch", (name,), weights=tmp_path))


def test_the_hub_cache_is_read_at_the_pinned_revision_only(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    snapshots = tmp_path / "hub" / "models--MCG-NJU--videomae-base" / "snapshots"
    snapshots.mkdir(parents=True)
    copy_release(folder, "videomae-base", snapshots).rename(snapshots / "c0ffee")
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path / "hub"))
    (tmp_path / "weights").mkdir()
    with pytest.raises(WeightsMissing, match="no folder"):
        find_weights("videomae-base", tmp_path / "weights")
    pin = (folder / "videomae-base.lock.json").read_text()
    (tmp_path / "weights" / "videomae-base.lock.json").write_text(pin)
    found = find_weights("videomae-base", tmp_path / "weights")
    assert found.path == snapshots / "c0ffee"
    load_encoder("videomae-base", {}, tmp_path / "weights")


def test_weights_verb(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights(WeightsConfig("list", weights=folder))
    listed = capsys.readouterr().out
    assert all(f"{name}: " in listed for name in KNOWN)
    assert f"Apache-2.0; {folder / 'dinov2-small'}\n" in listed
    assert "dinov2-large" in listed and "get it by `vidphys weights fetch dinov2-large`" in listed
    weights(WeightsConfig("check", ("vjepa2-l",), weights=folder))
    assert "is as expected" in capsys.readouterr().out
    copy_release(folder, "dinov2-small", tmp_path)
    weights(WeightsConfig("check", ("dinov2-small",), weights=tmp_path, lock=True))
    weights(WeightsConfig("check", ("dinov2-small",), weights=tmp_path))
    assert "locked" in capsys.readouterr().out
    with pytest.raises(InputError, match="no hub has them; get i3d_kinetics400.safetensors"):
        weights(WeightsConfig("fetch", ("i3d",), weights=tmp_path))


def write_clip(path: Path, count: int) -> Path:
    import cv2
    import numpy as np

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (48, 32))
    for k in range(count):
        writer.write(np.full((32, 48, 3), 20 * k, np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize("name", QUICK)
def test_extract_verb(
    name: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = write_clip(tmp_path / "a.avi", 9)
    options = dict(QUICK[name])
    layers = (options.pop("layer"),) if "layer" in options else ()
    config = ExtractConfig(
        (clip,), tmp_path / "store", encoder=name, weights=folder, layers=layers, **options
    )
    extract(config)
    first = capsys.readouterr().out
    step = load_encoder(name, QUICK[name], folder).windowing.tubelet
    assert f"a.avi: extracted, {-(-9 // step)} frames of " in first
    assert "clips/s" in first and "hit rate 0%" in first
    extract(config)
    assert "hit rate 100%" in capsys.readouterr().out
    refused = "leave out layer" if name == "vjepa2-l" else f"{name}: takes no predictor"
    with pytest.raises(InputError, match=refused) as caught:
        extract(
            ExtractConfig(
                (clip,), tmp_path / "o", encoder=name, weights=folder, predictor=True, layers=(1,)
            )
        )
    assert "\n" not in str(caught.value)


def ones_network() -> I3DNetwork:
    network = I3DNetwork().double().eval()
    for parameter in network.parameters():
        nn.init.ones_(parameter)
    return network


def field(maps: Callable[[Tensor], Tensor], shape: tuple[int, ...], axis: int) -> float:
    """The middle of what a unit sees along an axis, both ends of the maxima counted."""
    size = shape[axis]
    ramp = (1 + torch.arange(size).double()).view([-1 if k == axis else 1 for k in range(5)])
    seen = torch.zeros(size, dtype=torch.bool)
    for values in (ramp, ramp.flip(axis)):
        x = values.expand(shape).clone().requires_grad_()
        (gradient,) = torch.autograd.grad(maps(x), x)
        seen |= gradient.abs().movedim(axis, 0).flatten(1).sum(1) > 0
    inside = seen.nonzero()[:, 0]
    return float(inside[0] + inside[-1]) / 2


@pytest.mark.parametrize("axis", [0, 1])
def test_fields_of_i3d_lie_where_the_formula_says(axis: int) -> None:
    """With weights of one the field is the support of the gradient; its middle is the centre."""
    network, stage = ones_network(), "Conv3d_2c_3x3"
    found = field(lambda x: network(x, (stage,))[0][0, 0, 4, 7, 7], (1, 3, 16, 64, 64), 2 + axis)
    assert found == field_stride(stage, axis) * (4, 7)[axis] + field_centre(stage, axis)


def test_i3d_brings_its_fields_back_to_their_cells() -> None:
    settings = I3DSettings(layer="Conv3d_2c_3x3", resolution=64, frames=4)
    weights_file = WeightsFile(Path("none"), "0" * 64)
    encoder = I3DEncoder(ones_network(), settings, weights_file)
    found = field(
        lambda x: encoder.encode(x.float() / 64, (settings.layer,))[0][0, 1, 0, 7, 9].double(),
        (1, 4, 3, 64, 64),
        4,
    )
    assert abs(found - (4 * (9 + 0.5) - 0.5)) == 0.5  # two pixels more if they were not


@pytest.mark.parametrize(("kernel", "stride"), [((3, 3, 3), (2, 2, 2)), ((1, 3, 3), (1, 2, 2))])
def test_pooling_axis_by_axis_is_pooling(
    kernel: tuple[int, int, int], stride: tuple[int, int, int]
) -> None:
    x = torch.rand(2, 3, 5, 8, 7)
    # "SAME": the larger part of an odd padding comes last
    pads = [0, 0, 0, 0, 0, 0]
    for k, (size, width, step) in enumerate(zip((5, 8, 7), kernel, stride, strict=True)):
        missing = max((math.ceil(size / step) - 1) * step + width - size, 0)
        pads[4 - 2 * k : 6 - 2 * k] = [missing // 2, missing - missing // 2]
    expected = functional.max_pool3d(functional.pad(x, pads), kernel, stride)
    assert torch.equal(pool(x, kernel, stride), expected)


def test_i3d_stages(folder: Path) -> None:
    channels = (64, 64, 192, 256, 480, 512, 512, 512, 528, 832, 832, 1024)
    network = I3DNetwork().eval()
    x = torch.zeros(1, 3, 8, 32, 32)
    for stage, width in zip(STAGES, channels, strict=True):
        if stage in ("Conv3d_2b_1x1", "Mixed_3c", "Mixed_4b", "Mixed_5c"):
            with torch.no_grad():
                got = network(x, (stage,))[0].shape
            t, s = field_stride(stage, 0), field_stride(stage, 1)
            assert got == (1, width, 8 // t, 32 // s, 32 // s)


def real_i3d(**settings: Any) -> FrozenEncoder:
    where = os.environ.get("VIDPHYS_WEIGHTS")
    if where is None or not (Path(where) / I3D_FILE).is_file():
        pytest.skip(f"VIDPHYS_WEIGHTS does not name a folder with {I3D_FILE}")
    return load_i3d(I3DSettings(**settings), Path(where))


def square(x: list[int]) -> Tensor:
    """A white square whose left edge is at ``x`` in each frame."""
    clip = torch.zeros(1, len(x), 3, 64, 64)
    for k, left in enumerate(x):
        clip[0, k, :, 24:40, left : left + 16] = 1
    return clip


def test_real_i3d_sees_where_and_which_way() -> None:
    encoder = real_i3d(layer="Mixed_3c", resolution=64, frames=8)
    assert encoder.identity.weights_sha256 == KNOWN["i3d"].sha256[0]
    black = encoder(torch.zeros(1, 8, 3, 64, 64), times(8)).values
    found = encoder(square([40] * 8), times(8))
    assert found.values.shape == (1, 4, 480, 8, 8)
    change = (found.values - black)[0].norm(dim=1).mean(0)
    weight = change**4 / (change**4).sum()
    place = (found.cell_centres() * weight[..., None]).sum((0, 1))
    torch.testing.assert_close(place, torch.tensor([0.5, 0.0]), rtol=0, atol=0.12)
    # the same frame 3, on which a feature frame is centred, on the way there and on the way back
    there = encoder(square([24 + 2 * (k - 3) for k in range(8)]), times(8)).values[:, 1]
    back = encoder(square([24 - 2 * (k - 3) for k in range(8)]), times(8)).values[:, 1]
    ratio = (there - back).norm() / (there - black[:, 1]).norm()
    assert float(ratio) > 0.3
