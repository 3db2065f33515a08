"""V-JEPA 2-AC: a tiny checkpoint in the layout of the official file, and what it must hold to."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import pytest
import torch
from torch import Tensor

from encoders import weights as weights_module
from encoders.frozen import FrozenEncoder, load_encoder
from encoders.frozen.vjepa2_ac import VJEPA2ACEncoder
from encoders.frozen.vjepa2_ac_network import Predictor, rotate, turn_by_place
from encoders.known_weights import KNOWN
from encoders.release import WeightsMissing
from encoders.weights import fetch, lock
from tests.shared.layers import expect_layers

FILE, WIDTH, SIDE = KNOWN["vjepa2-ac"].file, 64, 32
QUICK = {"resolution": SIDE, "frames": 4, "batch": 2}
# the library's name of a part, and the release's
NAMES = (
    ("embeddings.patch_embeddings.", "patch_embed."),
    ("layernorm.", "norm."),
    ("layer.", "blocks."),
    (".attention.", ".attn."),
)


def random_like(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    rng = torch.Generator().manual_seed(3)
    return {k: torch.randn(v.shape, generator=rng) / 8 for k, v in tensors.items()}


def library_encoder() -> Any:
    from transformers import VJEPA2Config
    from transformers.models.vjepa2.modeling_vjepa2 import VJEPA2Encoder

    config = VJEPA2Config(
        patch_size=16,
        crop_size=SIDE,
        hidden_size=WIDTH,
        num_attention_heads=1,
        num_hidden_layers=2,
        mlp_ratio=4.5,
    )
    encoder = VJEPA2Encoder(config)
    encoder.load_state_dict(random_like(encoder.state_dict()))
    return encoder.eval()


def released_names(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """As the release has them: other names, and queries, keys and values in one."""
    found: dict[str, Tensor] = {}
    for key, value in tensors.items():
        for ours, theirs in NAMES:
            key = key.replace(ours, theirs)
        if ".query." in key:
            others = (tensors_key(key, part, tensors) for part in ("key", "value"))
            key, value = key.replace(".query.", ".qkv."), torch.cat([value, *others])
        if ".key." not in key and ".value." not in key:
            found[f"module.backbone.{key}"] = value
    return found


def tensors_key(key: str, part: str, tensors: dict[str, Tensor]) -> Tensor:
    library = key.replace(".query.", f".{part}.")
    for ours, theirs in reversed(NAMES):
        library = library.replace(theirs, ours)
    return tensors[library]


@pytest.fixture(scope="module")
def release() -> dict[str, Any]:
    predictor = random_like(Predictor(WIDTH, 2 * WIDTH, 256, 2).state_dict())
    return {
        "encoder": released_names(library_encoder().state_dict())
        | {"module.backbone.pos_embed": torch.zeros(1, 8, WIDTH)},
        "predictor": {f"module.{k}": v for k, v in predictor.items()},
        "opt": {"lr": 0.1},
        "epoch": 3,
    }


@pytest.fixture(scope="module")
def folder(release: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("weights")
    torch.save(release, path / FILE)
    lock(path / FILE, None)
    return path


@pytest.fixture(scope="module")
def encoder(folder: Path) -> VJEPA2ACEncoder:
    found = load_encoder("vjepa2-ac", QUICK, folder)
    assert isinstance(found, VJEPA2ACEncoder)
    return found


def clip(frames: int = 4) -> Tensor:
    return torch.rand(1, frames, 3, SIDE, SIDE, generator=torch.Generator().manual_seed(0))


def times(frames: int) -> Tensor:
    return torch.arange(frames, dtype=torch.float64)


def test_a_frame_is_seen_as_the_library_sees_two_copies_of_it(encoder: VJEPA2ACEncoder) -> None:
    seen = encoder.see(clip(3))
    mean = torch.tensor([0.485, 0.456, 0.406])[:, None, None]
    deviation = torch.tensor([0.229, 0.224, 0.225])[:, None, None]
    pixels = (clip(3)[0, 1] - mean) / deviation
    with torch.no_grad():
        tokens = library_encoder()(pixels.expand(1, 2, -1, -1, -1)).last_hidden_state
    want = torch.nn.functional.layer_norm(tokens[0], (WIDTH,)).T.reshape(WIDTH, 2, 2)
    torch.testing.assert_close(seen[0, 1], want, rtol=1e-4, atol=1e-4)


def test_both_layers_in_one_pass(folder: Path, encoder: VJEPA2ACEncoder) -> None:
    def alone(layer: str) -> FrozenEncoder:
        options = {**QUICK, "predictor": layer != "encoder"}
        return cast(FrozenEncoder, load_encoder("vjepa2-ac", options, folder))

    expect_layers(encoder, alone, clip(6), 1)


def test_places_turn_as_the_library_turns_them() -> None:
    from transformers.models.vjepa2.modeling_vjepa2 import rotate_queries_or_keys

    x, place = torch.randn(2, 3, 5, 20), torch.tensor([0.0, 1.0, 2.0, 3.0, 7.0])
    torch.testing.assert_close(rotate(x, place), rotate_queries_or_keys(x, place[None, None]))
    whole = torch.randn(2, 3, 5, 64)
    turned = turn_by_place(whole, torch.stack([place, 0 * place, 2 * place], -1))
    torch.testing.assert_close(turned[..., :20], rotate(whole[..., :20], place))
    torch.testing.assert_close(turned[..., 20:40], whole[..., 20:40])
    torch.testing.assert_close(turned[..., 40:60], rotate(whole[..., 40:60], 2 * place))
    torch.testing.assert_close(turned[..., 60:], whole[..., 60:])


def test_a_frame_is_foreseen_from_those_before_and_no_other(encoder: VJEPA2ACEncoder) -> None:
    seen = encoder.see(clip())
    changed = seen.clone()
    changed[:, 2] += torch.randn_like(changed[:, 2])
    before, after = encoder.foresee(seen), encoder.foresee(changed)
    torch.testing.assert_close(before[:, :2], after[:, :2])
    for frame in (2, 3):
        assert (before[:, frame] - after[:, frame]).abs().max() > 0.01
    early = torch.cat([seen[:, 1:2], seen[:, :1]], 1)
    assert not torch.allclose(encoder.foresee(early)[:, 1], encoder.foresee(seen[:, :2])[:, 1])


def test_features_are_what_is_foreseen_or_what_is_seen(
    encoder: VJEPA2ACEncoder, folder: Path
) -> None:
    frames = clip()
    torch.testing.assert_close(
        encoder(frames, times(4)).values, encoder.foresee(encoder.see(frames))
    )
    plain = load_encoder("vjepa2-ac", {**QUICK, "predictor": False}, folder)
    found = plain(frames, times(4))
    torch.testing.assert_close(found.values, encoder.see(frames))
    torch.testing.assert_close(found.times, times(4))
    assert found.stride == (16.0, 16.0) and plain.identity != encoder.identity


def test_the_arms_state_is_told(encoder: VJEPA2ACEncoder, folder: Path) -> None:
    resting = load_encoder("vjepa2-ac", {**QUICK, "state": "resting"}, folder)
    assert resting.identity != encoder.identity
    difference = resting(clip(), times(4)).values - encoder(clip(), times(4)).values
    assert difference.abs().max() > 1e-3


@pytest.mark.parametrize(
    ("part", "words"), [("predictor", "1 keys missing"), ("encoder", "1 keys missing")]
)
def test_it_loads_strictly(release: dict[str, Any], tmp_path: Path, part: str, words: str) -> None:
    less = dict(release[part])
    less.pop(next(key for key in less if key.endswith("norm1.bias")))
    torch.save({**release, part: less}, tmp_path / FILE)
    lock(tmp_path / FILE, None)
    with pytest.raises(ValueError, match=words):
        load_encoder("vjepa2-ac", QUICK, tmp_path)


def test_another_file_is_refused(tmp_path: Path) -> None:
    torch.save({"model": {}}, tmp_path / FILE)
    lock(tmp_path / FILE, None)
    with pytest.raises(ValueError, match="is not the release of vjepa2-ac"):
        load_encoder("vjepa2-ac", QUICK, tmp_path)


def test_it_is_fetched_by_name_and_locked(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(WeightsMissing, match="`vidphys weights fetch vjepa2-ac`"):
        load_encoder("vjepa2-ac", QUICK, tmp_path)
    asked = []

    def copy(url: str, target: Path, show: object) -> Path:
        asked.append(url)
        target.write_bytes((folder / FILE).read_bytes())
        return target

    monkeypatch.setattr(weights_module, "download", copy)
    found = fetch("vjepa2-ac", tmp_path)
    assert asked == [KNOWN["vjepa2-ac"].url] and found.path == tmp_path / FILE
    load_encoder("vjepa2-ac", QUICK, tmp_path)

    def broken(url: str, target: Path, show: object) -> Path:
        raise ConnectionError("no route")

    monkeypatch.setattr(weights_module, "download", broken)
    with pytest.raises(ConnectionError, match="no route"):
        fetch("vjepa2-ac", tmp_path / "other")
