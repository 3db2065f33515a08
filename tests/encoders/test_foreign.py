"""An encoder from outside: plain or one of our base, known by its path, filed under its version."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
import torch

from encoders.frozen import load_encoder
from registry import RegistryError

NUMBERS = itertools.count()
MODULE = """
import torch
from encoders import FeatureMap

class Means:
    def __init__(self, cell=4):
        self.cell = cell

    def __call__(self, frames, times):
        values = torch.nn.functional.avg_pool2d(frames.flatten(0, 1), self.cell)
        stride = float(self.cell)
        return FeatureMap(values.unflatten(0, frames.shape[:2]), (stride, stride), times)

def late(frames_per_feature=2):
    means = Means()
    means.frames_per_feature = frames_per_feature
    return means
"""


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Its file; the name is another in each test, because what was once imported stays known."""
    file = tmp_path / f"stranger_{next(NUMBERS)}.py"
    file.write_text(MODULE)
    monkeypatch.syspath_prepend(str(tmp_path))
    return file


def clips() -> tuple[torch.Tensor, torch.Tensor]:
    torch.manual_seed(0)
    return torch.randint(256, (2, 3, 3, 8, 12), dtype=torch.uint8), torch.arange(3.0).double() / 25


def test_a_plain_encoder_is_called_with_floats_a_clip_at_a_time(stranger: Path) -> None:
    encoder = load_encoder(f"{stranger.stem}:Means", {"cell": 2, "layer": None})
    frames, times = clips()
    told: list[tuple[int, int]] = []
    found = encoder(frames, times, lambda done, total: told.append((done, total)))
    assert found.values.shape == (2, 3, 3, 4, 6) and encoder.frames_per_feature == 1
    assert torch.equal(found.values[1:], encoder(frames[1:].float() / 255, times).values)
    assert told == [(3, 6), (6, 6)]


@pytest.mark.parametrize(
    ("options", "text"), [({"layer": 3}, "takes no layer; it takes cell"), ({}, "takes no device")]
)
def test_an_option_that_it_does_not_take_is_refused_by_name(
    stranger: Path, options: dict[str, int], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        load_encoder(f"{stranger.stem}:Means", options, device="cpu" if options else "cuda")


def test_features_of_other_code_or_options_are_others(stranger: Path) -> None:
    first = load_encoder(f"{stranger.stem}:Means", {})
    assert first.identity == load_encoder(f"{stranger.stem}:Means", {}).identity
    assert first.identity != load_encoder(f"{stranger.stem}:Means", {"cell": 2}).identity
    stranger.write_text(MODULE.replace("avg_pool2d", "max_pool2d"))
    assert first.identity != load_encoder(f"{stranger.stem}:Means", {}).identity


def test_features_that_are_not_what_was_promised_are_refused(stranger: Path) -> None:
    with pytest.raises(ValueError, match=r"one clip of 3 frames must give features \(1, 2, c"):
        load_encoder(f"{stranger.stem}:late", {})(*clips())
    with pytest.raises(ValueError, match="must be finite"):
        load_encoder(f"{stranger.stem}:Means", {})(clips()[0].float() * torch.nan, clips()[1])
    with pytest.raises(RegistryError, match="Meens cannot be imported"):
        load_encoder(f"{stranger.stem}:Meens", {})
