"""An entry that is written piece by piece is the file that safetensors writes at once."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from encoders.arrays import as_kept, numbers
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
    for form in (torch.Tensor.clone, torch.Tensor.numpy):
        with pieces.open("wb") as file:
            origin = Origin("clip", (8, 8), form(times))
            entry = EntryFile(file, origin, str(dtype).removeprefix("torch."))
            for piece in values.split(2):
                entry.add(form(piece))
        assert pieces.read_bytes() == whole.read_bytes()
        assert entry.finished() == {
            "shape": list(shape),
            "bytes": whole.stat().st_size,
            "sha256": hashlib.sha256(whole.read_bytes()).hexdigest(),
        }


def test_numpy_rounds_to_bfloat16_as_torch_does():
    bits = torch.arange(0, 2**32, 20011, dtype=torch.int64).to(torch.int32)
    halves = torch.tensor([0x3F808000, 0x3F818000, 0x3F817FFF, 0x3F818001], dtype=torch.int32)
    values = torch.cat([bits, halves]).view(torch.float32)
    values = values[values.bfloat16().isfinite()]
    kept = as_kept(values.numpy(), "bfloat16")
    assert np.array_equal(kept, values.bfloat16().view(torch.uint16).numpy())
    assert np.array_equal(numbers(kept), values.bfloat16().float().numpy())


def test_what_does_not_fit(tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        entry = EntryFile(file, Origin("clip.mp4", (8, 8), torch.arange(3.0)), "float16")
        for piece in (torch.full((1, 1, 1, 1), 1e6), np.full((1, 1, 1, 1), 1e6)):
            with pytest.raises(ValueError, match="clip.mp4 are not finite in float16; use float32"):
                entry.add(piece)
        entry.add(torch.ones(2, 1, 1, 1))
        with pytest.raises(ValueError, match="2 feature frames of clip.mp4 came in, and 3 times"):
            entry.finished()
    for bad in (3.4e38, np.inf, -np.inf, np.nan):
        assert as_kept(np.full(1, bad), "bfloat16") is None
