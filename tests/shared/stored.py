"""Entries of a feature store by their number."""

from __future__ import annotations

import dataclasses

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
