"""Clips small enough to train on in a test, and an encoder that needs no weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from torch import Tensor, nn
from torch.nn import functional

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.catalogue import ENCODERS, Adapter
from encoders.frozen.windows import Windowing
from vidphys.data.rendered import write_video
from vidphys.data.video import Video
from vidphys.errors import InputError

RATE, SIDE = 25.0, 32


@dataclass(frozen=True)
class CellsSettings:
    layer: int = 4
    frames: int = 1
    batch: int = 8
    dtype: str = "float32"


class Cells(FrozenEncoder):
    """Mean colour of square cells of ``layer`` pixels, those of ``frames`` frames side by side."""

    passes = 0  # of all encoders

    def __init__(self, settings: CellsSettings, sha256: str) -> None:
        windowing = Windowing(settings.frames, tubelet=settings.frames)
        super().__init__(
            nn.Linear(1, 1),
            settings,
            windowing,
            ("2", "4", "8"),
            name="cells",
            code_version=1,
            weights_sha256=sha256,
            preprocessing="none",
            layer=str(settings.layer),
            resolution=SIDE,
        )

    def encode(self, clips: Tensor, layers: tuple[str, ...]) -> list[Tensor]:
        Cells.passes += 1
        light = [functional.avg_pool2d(clips.flatten(0, 1), int(layer)) for layer in layers]
        return [maps.unflatten(0, clips.shape[:2]).flatten(1, 2)[:, None] for maps in light]


def know_cells(patch: pytest.MonkeyPatch) -> dict[str, str]:
    """Put ``cells`` into the catalogue; the hash of its weights can be changed."""
    hashes = {"sha256": "0" * 64}
    adapter = Adapter(CellsSettings, lambda s, where, device: Cells(s, hashes["sha256"]))
    patch.setitem(ENCODERS._parts, "cells", adapter)
    patch.setitem(ENCODERS._modules, "cells", __name__)
    return hashes


@pytest.fixture
def cells(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    return know_cells(monkeypatch)


def swing(frames: int, phase: float) -> np.ndarray:
    """Pixels (u, v) of a body that swings along a shallow curve, ``(t, 1, 2)``."""
    angle = 0.9 * np.sin(2 * np.pi * np.arange(frames) / RATE / 1.2 + phase)
    return np.stack([15.5 + 10 * np.sin(angle), 9.5 + 10 * np.cos(angle)], -1)[:, None]


def pictures(places: np.ndarray) -> np.ndarray:
    """A red disk at ``places (t, 1, 2)`` in pixels before grey."""
    v, u = np.mgrid[:SIDE, :SIDE]
    frames = np.empty((len(places), SIDE, SIDE, 3), np.uint8)
    for frame, ((cu, cv),) in zip(frames, places, strict=True):
        body = np.clip(4.0 - np.hypot(u - cu, v - cv), 0, 1)[..., None]
        frame[:] = np.rint(110 * (1 - body) + np.array([230, 30, 40]) * body)
    return frames


def write_clip(path: Path, frames: int, phase: float = 0.0, table: bool = True) -> None:
    """A clip of the swinging body, with its places in pixels beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    places = swing(frames, phase)
    write_video(path, pictures(places), RATE)
    if table:
        rows = "\n".join(f"{u:.6f},{v:.6f}" for u, v in places[:, 0])
        path.with_suffix(".csv").write_text(f"u1,v1\n{rows}\n")


def cut_short(video: Video) -> Video:
    """A clip that ends in an error after its first frames, two black ones."""

    class Frames:
        held = True
        shape = video.frames.shape

        def chunks(self) -> Iterator[np.ndarray]:
            yield np.zeros((2, *self.shape[1:]), np.uint8)
            raise InputError("cut short")

    return replace(video, frames=Frames())  # type: ignore[arg-type]
