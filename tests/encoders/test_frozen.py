"""Frozen encoders: the right weights or none, the same features whatever the batch."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from safetensors.torch import load_file, save_file
from torch import Tensor

from encoders import weights as weights_module
from encoders.frozen.hiera import HieraEncoder, HieraSettings, build_trunk, load_hiera
from encoders.known_weights import KNOWN
from encoders.preprocess import IMAGENET, network_size, to_rgb
from encoders.release import WeightsMissing, file_sha256
from encoders.weights import fetch, find_weights, lock, weights_folder
from tests.shared.layers import expect_layers
from vidphys.cli.extract import ExtractConfig, extract
from vidphys.cli.weights import WeightsConfig, weights
from vidphys.errors import InputError

FILE = KNOWN["hiera"].file


def patterned() -> dict[str, Tensor]:
    """Weights of the official layout that depend on no random number generator."""
    filled = {}
    for number, (key, value) in enumerate(build_trunk().state_dict().items()):
        if key.startswith("head."):
            continue
        wave = torch.sin(torch.arange(value.numel()) * 0.7 + number).reshape(value.shape)
        norm = "norm" in key and key.endswith("weight")
        filled[key] = (1 + 0.1 * wave if norm else 0.04 * wave).half()
    return filled


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A weights folder in the official layout, its file locked."""
    path = tmp_path_factory.mktemp("weights")
    save_file(patterned(), path / FILE)
    lock(path / FILE, None)
    return path


@pytest.fixture(scope="module")
def encoder(folder: Path) -> HieraEncoder:
    return load_hiera(HieraSettings(resolution=64, batch=3), folder)


def frames(count: int, height: int = 48, width: int = 64, channels: int = 3) -> Tensor:
    return torch.rand(1, count, channels, height, width)


def times(count: int) -> Tensor:
    return torch.arange(count) * 0.08


def test_golden(encoder: HieraEncoder) -> None:
    """Numbers written down from timm 1.0.31; they depend on no generator."""
    ramp = torch.linspace(0, 1, 64)
    image = torch.stack([ramp.expand(64, 64), ramp[:, None].expand(64, 64), ramp.outer(ramp)])
    values = encoder(image[None, None], times(1)).values[0, 0]
    assert values.shape == (192, 8, 8)
    expected = torch.tensor([0.816271, 1.309711, -0.888009, 0.647202])
    got = torch.tensor([values[0, 0, 0], values[17, 3, 5], values[100, 7, 0], values[191, 4, 4]])
    torch.testing.assert_close(got, expected, rtol=1e-3, atol=1e-4)
    assert float(values.std()) == pytest.approx(0.860167, rel=1e-3)


def test_a_frame_has_the_same_features_in_any_company(encoder: HieraEncoder) -> None:
    clip, sizes = frames(7), set()
    first = encoder.network.patch_embed.register_forward_pre_hook(  # type: ignore[union-attr,operator]
        lambda _, inputs: sizes.add(tuple(inputs[0].shape))
    )
    together = encoder(clip, times(7)).values
    for i in range(7):
        alone = encoder(clip[:, i : i + 1], times(1)).values
        assert torch.equal(alone[:, 0], together[:, i])
    assert torch.equal(encoder(clip[:, 2:6], times(4)).values, together[:, 2:6])
    stacked = encoder(torch.cat([clip, clip.flip(1)]), times(7)).values
    assert torch.equal(stacked[0], together[0])
    assert torch.equal(stacked[1], together[0].flip(0))
    first.remove()
    assert sizes == {(3, 3, 64, 64)}  # equal shapes, so no kernel is chosen by the batch


@pytest.mark.parametrize(("height", "width"), [(48, 64), (33, 57), (100, 31), (5, 5), (64, 64)])
def test_grid_covers_the_image_that_was_given(
    encoder: HieraEncoder, height: int, width: int
) -> None:
    found = encoder(frames(1, height, width), times(1))
    h, w = found.grid
    assert (h * found.stride[0], w * found.stride[1]) == pytest.approx((height, width))
    assert max(h, w) == 8
    edge = found.cell_centres().abs().amax((0, 1)) + torch.tensor(
        [found.stride[1], found.stride[0]]
    ) / max(height, width)
    half = torch.tensor([width, height]) / max(height, width)
    torch.testing.assert_close(edge, half)


@pytest.mark.parametrize(("layer", "channels"), [(4, 96), (8, 192), (16, 384), (32, 768)])
def test_layers(folder: Path, layer: int, channels: int) -> None:
    encoder = load_hiera(HieraSettings(layer=layer, resolution=64, batch=1), folder)  # type: ignore[arg-type]
    ran = []
    for name, block in encoder.network.blocks.named_children():  # type: ignore[union-attr]
        block.register_forward_hook(lambda *_, name=name: ran.append(int(name)))
    values = encoder(frames(1, 64, 64), times(1)).values
    assert values.shape == (1, 1, channels, 64 // layer, 64 // layer)
    assert ran == list(range({4: 1, 8: 3, 16: 10, 32: 12}[layer]))  # later stages do not run


def test_frozen_yet_usable_in_training(encoder: HieraEncoder) -> None:
    assert not any(p.requires_grad for p in encoder.network.parameters())
    assert not encoder.network.training
    values = encoder(frames(1), times(1)).values
    assert not values.requires_grad
    scale = torch.ones(192, 1, 1, requires_grad=True)
    (values * scale).sum().backward()
    assert scale.grad is not None


def test_bfloat16_is_close(folder: Path, encoder: HieraEncoder) -> None:
    clip = frames(1)
    half = load_hiera(HieraSettings(resolution=64, batch=3, dtype="bfloat16"), folder)
    exact, rough = encoder(clip, times(1)).values, half(clip, times(1)).values
    assert rough.dtype == torch.float32
    assert 0 < (rough - exact).norm() / exact.norm() < 0.05
    assert half.identity != encoder.identity


def test_channels(encoder: HieraEncoder) -> None:
    grey = frames(2, channels=1)
    as_rgb = encoder(grey.expand(-1, -1, 3, -1, -1), times(2)).values
    assert torch.equal(encoder(grey, times(2)).values, as_rgb)
    assert encoder(frames(1, channels=5), times(1)).values.shape[2] == 192


def test_channels_of_bodies_get_hues_of_their_own() -> None:
    three = torch.rand(2, 3, 4, 4)
    assert torch.equal(to_rgb(three), three)
    four = to_rgb(torch.eye(4)[None, :, :, None])[0, :, :, 0].T
    assert torch.equal(four[0], torch.tensor([1.0, 0, 0]))
    assert len({tuple(c.tolist()) for c in four}) == 4
    assert to_rgb(torch.ones(1, 5, 2, 2)).max() == 1


def test_normalise_is_imagenet() -> None:
    mean = torch.tensor([0.485, 0.456, 0.406])[None, :, None, None]
    std = torch.tensor([0.229, 0.224, 0.225])[None, :, None, None]
    pixels = IMAGENET.clips((mean + 0.2 * std)[None], (1, 1), torch.float32)
    torch.testing.assert_close(pixels, torch.full((1, 1, 3, 1, 1), 0.2))


@given(st.integers(1, 3000), st.integers(1, 3000), st.integers(1, 16))
def test_network_size(height: int, width: int, blocks: int) -> None:
    resolution = 32 * blocks
    size = network_size(height, width, resolution, 32)
    assert max(size) == resolution
    assert all(s >= 32 and s % 32 == 0 for s in size)
    ideal = [resolution * n / max(height, width) for n in (height, width)]
    assert all(s == 32 or abs(s - i) <= 16 for s, i in zip(size, ideal, strict=True))


def test_bad_input(encoder: HieraEncoder, folder: Path) -> None:
    with pytest.raises(ValueError, match="needs at least one frame"):
        encoder(frames(1)[:, :0], times(0))
    spoilt = frames(2)
    spoilt[0, 1, 0, 3, 3] = float("nan")
    with pytest.raises(ValueError, match="must be finite"):
        encoder(spoilt, times(2))
    with pytest.raises(ValueError, match="multiple of 32; the nearest is 96"):
        load_hiera(HieraSettings(resolution=100), folder)


def test_missing_weights_name_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(WeightsMissing, match="`vidphys weights fetch hiera`.*as `weights`"):
        load_hiera(HieraSettings(), tmp_path)
    monkeypatch.setenv("VIDPHYS_WEIGHTS", str(tmp_path / "elsewhere"))
    with pytest.raises(WeightsMissing, match="elsewhere"):
        find_weights("hiera")
    monkeypatch.delenv("VIDPHYS_WEIGHTS")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert weights_folder() == tmp_path / "cache" / "vidphys" / "weights"
    with pytest.raises(ValueError, match="unknown name 'dino'; known are hiera"):
        find_weights("dino")


def test_weights_are_found_by_folder_file_and_variable(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VIDPHYS_WEIGHTS", str(folder))
    expected = file_sha256(folder / FILE)
    for where in (None, folder, folder / FILE):
        assert find_weights("hiera", where).sha256 == expected


def test_an_unknown_hash_is_refused_until_locked(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / FILE
    copy.write_bytes((folder / FILE).read_bytes())
    with pytest.raises(ValueError, match=r"has sha256 .*, expected 1783be24.*`lock`"):
        find_weights("hiera", tmp_path)
    lock(copy, None)
    assert find_weights("hiera", tmp_path).path == copy
    with copy.open("r+b") as file:
        file.seek(-1, os.SEEK_END)
        file.write(b"\x00")
    with pytest.raises(ValueError, match="damaged or another release"):
        find_weights("hiera", tmp_path)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda t: t.pop("blocks.5.attn.qkv.weight"), "1 keys missing .*blocks.5.attn.qkv.weight"),
        (lambda t: t.update(extra=torch.ones(1)), "1 unknown .*extra"),
        (lambda t: t.update({"pos_embed": torch.ones(1, 96, 7, 8)}), "pos_embed has shape"),
    ],
)
def test_loading_is_strict(folder: Path, tmp_path: Path, spoil: object, message: str) -> None:
    tensors = load_file(folder / FILE)
    spoil(tensors)  # type: ignore[operator]
    save_file(tensors, tmp_path / FILE)
    lock(tmp_path / FILE, None)
    with pytest.raises(ValueError, match=message):
        load_hiera(HieraSettings(), tmp_path)


def test_every_tensor_is_loaded(encoder: HieraEncoder, folder: Path) -> None:
    loaded = encoder.network.state_dict()
    for key, value in load_file(folder / FILE).items():
        assert torch.equal(loaded[key], value.float()), key


def test_not_a_safetensors_file(tmp_path: Path) -> None:
    (tmp_path / FILE).write_bytes(b"nonsense " * 10)
    lock(tmp_path / FILE, None)
    with pytest.raises(ValueError, match="is not a safetensors file"):
        load_hiera(HieraSettings(), tmp_path)


def test_fetch_pins_what_it_got(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def from_hub(repository: str, file: str, revision: str | None) -> tuple[Path, str]:
        asked.append((repository, file, revision))
        return folder / FILE, revision or "c0ffee"

    monkeypatch.setattr(weights_module, "from_hub", from_hub)
    known = replace(KNOWN["hiera"], sha256=())
    monkeypatch.setitem(KNOWN, "hiera", known)
    target = tmp_path / "new"
    assert fetch("hiera", target).path == target / FILE
    (target / FILE).unlink()
    fetch("hiera", target)  # the second time at the commit of the first
    fetch("hiera", target)  # and not again
    hub = ("timm/sam2_hiera_tiny.fb_r896", "model.safetensors")
    assert asked == [(*hub, None), (*hub, "c0ffee")]
    assert find_weights("hiera", target).sha256 == file_sha256(folder / FILE)


def test_weights_verb(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weights(WeightsConfig("list", weights=tmp_path))
    assert (
        "Apache-2.0; not here, get it by `vidphys weights fetch hiera`" in capsys.readouterr().out
    )
    weights(WeightsConfig("check", weights=tmp_path))
    assert capsys.readouterr().out.startswith("hiera: not here\ni3d: not here\n")
    weights(WeightsConfig("check", ("hiera",), weights=folder))
    assert "is as expected" in capsys.readouterr().out
    (tmp_path / FILE).write_bytes((folder / FILE).read_bytes())
    with pytest.raises(InputError, match="`lock`"):
        weights(WeightsConfig("check", weights=tmp_path))
    weights(WeightsConfig("check", weights=tmp_path, lock=True))
    assert not list(weights_module.PACKAGED.glob("*.lock.json"))
    weights(WeightsConfig("check", weights=tmp_path))
    for config, message in [
        (WeightsConfig("check", ("dino",)), "unknown name 'dino'"),
        (WeightsConfig("check", ("hiera",), weights=tmp_path / "no"), "no file"),
        (WeightsConfig("fetch"), "name what to fetch"),
        (WeightsConfig("list", lock=True), "--lock goes with check"),
    ]:
        with pytest.raises(InputError, match=message):
            weights(config)


def test_a_fetch_without_a_network_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreachable(*_: object) -> None:
        raise RuntimeError("no route\nto the hub")

    monkeypatch.setattr("huggingface_hub.HfApi.model_info", unreachable)
    with pytest.raises(
        InputError, match=r"did not give it .*no route\); get it elsewhere"
    ) as caught:
        weights(WeightsConfig("fetch", ("hiera",), weights=tmp_path))
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def write_clip(path: Path, count: int = 5) -> Path:
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for k in range(count):
        writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
    writer.release()
    return path


def test_extract_verb(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clips = (write_clip(tmp_path / "a.avi"), write_clip(tmp_path / "b.avi", 2))
    config = ExtractConfig(
        clips, tmp_path / "store", encoder="hiera", weights=folder, resolution=64, batch=2
    )
    extract(config)
    first = capsys.readouterr().out
    assert "a.avi: extracted, 5 frames of 192 channels on a 8 x 8 grid" in first
    assert "2 clips, 7 frames" in first and "hit rate 0%" in first
    extract(config)
    second = capsys.readouterr().out
    assert "b.avi: in store, 2 frames" in second and "hit rate 100%" in second
    assert "clips/s" in second and "frames/s" in second


def test_extract_refuses_bad_input(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    clip, out = write_clip(tmp_path / "a.avi"), tmp_path / "store"
    for config, message in [
        (ExtractConfig((), out, encoder="hiera", weights=folder), "no clips"),
        (
            ExtractConfig((clip, tmp_path / "no.avi"), out, encoder="hiera", weights=folder),
            "no.avi: no such file",
        ),
        (
            ExtractConfig((clip,), out, encoder="hiera", weights=tmp_path),
            "vidphys weights fetch hiera",
        ),
        (
            ExtractConfig((clip,), out, encoder="hiera", weights=folder, resolution=70),
            "multiple of 32",
        ),
        (ExtractConfig((clip,), out, encoder="hiera", weights=folder, stride=0), "stride 0"),
        (
            ExtractConfig((clip,), out, encoder="hiera", weights=folder, device="cuda"),
            "`device` cuda: .*use cpu",
        ),
    ]:
        with pytest.raises(InputError, match=message) as caught:
            extract(config)
        assert "\n" not in str(caught.value)
    assert not out.exists()


def test_all_stages_in_one_pass(folder: Path, encoder: HieraEncoder) -> None:
    def alone(layer: str) -> HieraEncoder:
        return load_hiera(HieraSettings(layer, resolution=64, batch=3), folder)

    expect_layers(encoder, alone, frames(4), 2)


def test_real_weights() -> None:
    where = os.environ.get("VIDPHYS_WEIGHTS")
    if where is None or not (Path(where) / FILE).is_file():
        pytest.skip(f"VIDPHYS_WEIGHTS does not name a folder with {FILE}")
    encoder = load_hiera(HieraSettings(resolution=64), Path(where))
    assert encoder.identity.weights_sha256 == KNOWN["hiera"].sha256[0]
    image = torch.zeros(1, 2, 3, 64, 64)
    image[0, 1, 0, 24:40, 8:24] = 1  # a red square in the second frame
    values = encoder(image, times(2)).values[0]
    assert torch.isfinite(values).all()
    change = (values[1] - values[0]).norm(dim=0)
    row, column = divmod(int(change.argmax()), 8)
    assert 3 <= row <= 4 and 1 <= column <= 2
