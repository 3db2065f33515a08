"""Entries of a feature store by their number."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import torch

from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from encoders.store import FeatureRequest, FeatureStore

IDENTITY = EncoderIdentity("fake", 1, "a" * 64, "none", "8", 128, "float32")
TIMES = torch.tensor([0.0, 0.1], dtype=torch.float64)


def request(number, dtype="float32", **identity):
    encoder = dataclasses.replace(IDENTITY, **identity)
    return FeatureRequest(encoder, f"{number:064x}", (0, 1), (0.0, 0.1), (48, 32), dtype)


def made(number):
    rng = torch.Generator().manual_seed(number)
    return FeatureMap(torch.randn(1, 2, 5, 4, 2, generator=rng), (12.0, 16.0), TIMES)


def fill(folder, numbers, **identity):
    store = FeatureStore(folder)
    for number in numbers:
        store.write(request(number, **identity), "clip.mp4", made(number))
    return store


def parts_of(entry: Path) -> tuple[bytes, bytes]:
    """The tensors and the manifest in an entry's file."""
    whole = entry.read_bytes()
    begin = -4 - int.from_bytes(whole[-4:], "little")
    return whole[:begin], whole[begin:-4]


def put_together(entry: Path, tensors: bytes, manifest: bytes) -> None:
    """The reverse of :func:`parts_of`."""
    entry.write_bytes(tensors + manifest + len(manifest).to_bytes(4, "little"))


def as_older(folder: Path) -> None:
    """Lay entries down as stores of before did, a manifest and its tensors each."""
    for entry in (folder / "entries").glob("*.entry"):
        tensors, manifest = parts_of(entry)
        entry.with_suffix(".safetensors").write_bytes(tensors)
        entry.with_suffix(".json").write_bytes(manifest)
        entry.unlink()
