"""A frozen encoder and the readout that was trained over it: frames in, tracks out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from binders.motion import camera_path
from binders.tracks import Tracks
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.identity import IdentifiedEncoder
from readouts.attention import AttentionReadout
from vidphys.data.feature_frames import frame_tracks
from vidphys.training.readouts import read_all

Layer = int | str | None
STORED = torch.float16  # what `extract` stores unless told otherwise


@dataclass(frozen=True)
class LoadedEncoder:
    """A frozen encoder, and what it was loaded by."""

    name: str
    options: dict[str, Any]
    network: IdentifiedEncoder


def load_layers(
    name: str,
    options: dict[str, Any],
    layers: Sequence[Layer],
    weights: Path | None = None,
    device: str = "cpu",
) -> dict[Layer, LoadedEncoder]:
    """One encoder for each layer that is read; ``None`` is its own default.

    Args:
        name, options: of the catalogue, without the layer.
        layers: that are read.
        weights, device: see :func:`encoders.frozen.catalogue.load_encoder`.

    Raises:
        ValueError: an unknown name or option, or weights that are missing or wrong.
    """
    found = {}
    for layer in layers:
        given = {**options, "layer": layer}
        kept = {key: value for key, value in given.items() if value is not None}
        found[layer] = LoadedEncoder(name, kept, load_encoder(name, kept, weights, device))
    return found


@dataclass(frozen=True)
class Reader:
    """Frames to tracks.

    Args:
        encoder: frozen.
        readout: positions in normalised image units; a query for each body in each frame that a
            feature frame stands for.
        bodies: number of bodies.
        half_extent: world units in half of the longer image side.
        follows_camera: whether the drift of a camera is to be taken out of the tracks.
        stride, side: of the frames that are read; see :class:`vidphys.data.video.ClipSelection`.
    """

    encoder: LoadedEncoder
    readout: AttentionReadout
    bodies: int
    half_extent: float
    follows_camera: bool
    stride: int = 1
    side: int | None = None

    def features(self, frames: np.ndarray, times: np.ndarray) -> FeatureMap:
        """Of RGB bytes ``(t, H, W, 3)``, row 0 on top, at ``times`` (seconds).

        They are rounded as in a store, so that a clip is read as it was in training.
        """
        moving = torch.from_numpy(frames).permute(0, 3, 1, 2)[None]
        found = self.encoder.network(moving, torch.from_numpy(times))
        return FeatureMap(found.values.to(STORED), found.stride, found.times)

    def tracks(self, features: FeatureMap, times: Tensor) -> Tracks:
        """Positions as they are seen, world units, of one clip whose frames are at ``times``."""
        values = features.values[0].cpu()
        positions, sure = read_all(self.readout, values, features.cell_centres().cpu())
        found = frame_tracks(positions, sure, times, self.encoder.network.frames_per_feature)
        return Tracks(self.half_extent * found.positions, found.confidence, times)

    def camera(self, frames: np.ndarray) -> Tensor:
        """Displacement of the background in each frame ``(t, 2)``, world units."""
        if not self.follows_camera:
            return torch.zeros(len(frames), 2)
        return self.half_extent * camera_path(frames)


def steady(tracks: Tracks, camera: Tensor) -> Tracks:
    """Tracks as a camera without drift would have seen them; both in world units."""
    moved = tracks.positions - camera[None, :, None]
    return Tracks(moved, tracks.confidence, tracks.times)
