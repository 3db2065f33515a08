"""An entry that is written piece by piece is the file that safetensors writes at once."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from encoders.entry import EntryFile, Origin


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
@pytest.mark.parametrize("clock", [torch.float32, torch.float64])
@pytest.mark.parametrize("shape", [(5, 3, 4, 2), (1, 384, 16, 16), (7, 1, 1, 1)])
def test_the_same_bytes(
    tmp_path: Path, dtype: torch.dtype, clock: torch.dtype, shape: tuple[int, ...]
) -> None:
    values, times = torch.randn(shape), torch.arange(shape[0], dtype=clock) / 3
    whole, pieces = tmp_path / "whole", tmp_path / "pieces"
    save_file({"values": values.to(dtype), "times": times}, whole)
    with pieces.open("wb") as file:
        entry = EntryFile(file, Origin("clip", (8, 8), times), dtype)
        for piece in values.split(2):
            entry.add(piece)
    assert pieces.read_bytes() == whole.read_bytes()
    assert entry.about() == {
        "shape": list(shape),
        "bytes": whole.stat().st_size,
        "sha256": hashlib.sha256(whole.read_bytes()).hexdigest(),
    }


def test_what_does_not_fit(tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        entry = EntryFile(file, Origin("clip.mp4", (8, 8), torch.arange(3.0)), torch.float16)
        with pytest.raises(ValueError, match="clip.mp4 are not finite in float16; use float32"):
            entry.add(torch.full((1, 1, 1, 1), 1e6))
        entry.add(torch.ones(2, 1, 1, 1))
        with pytest.raises(ValueError, match="2 feature frames of clip.mp4 came in, and 3 times"):
            entry.about()
