"""A frozen encoder and the readout that was trained over it: frames in, tracks out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from binders.steadied import camera_path
from binders.tracks import Tracks
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.identity import IdentifiedEncoder, LayeredEncoder, stream
from readouts.attention import confidence_at, distance_at
from readouts.base import Readout
from vidphys.data.extraction import Axes, pictures
from vidphys.data.frames import Frames
from vidphys.placement import CPU, moved
from vidphys.training.readouts import read_all

Layer = int | str | None
STORED = torch.float16  # what `extract` stores unless told otherwise
ALONG_X, ALONG_Y = -1, -2  # axes of frames, (..., H, W)
MIRRORS: tuple[Axes, ...] = ((), (ALONG_X,), (ALONG_Y,), (ALONG_X, ALONG_Y))


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
    """An encoder for each layer that is read, over one network; ``None`` is its own default.

    Args:
        name, options: of the catalogue, without the layer.
        layers: that are read.
        weights, device: see :func:`encoders.frozen.catalogue.load_encoder`.

    Raises:
        ValueError: an unknown name or option, or weights that are missing or wrong.
    """
    found: dict[Layer, LoadedEncoder] = {}
    first: LayeredEncoder | None = None
    for layer in layers:
        given = {**options, "layer": layer}
        kept = {key: value for key, value in given.items() if value is not None}
        if first is not None and str(layer) in first.layers:
            network = first.at(str(layer))
        else:  # or one of another package, which is made for its layer
            first = network = load_encoder(name, kept, weights, device)
        found[layer] = LoadedEncoder(name, kept, network)
    return found


@dataclass(frozen=True)
class Reader:
    """Frames to tracks, for any frozen encoder and any readout.

    Args:
        encoder: of images or of video. A feature frame of a video encoder stands for several
            frames of the clip; the readout tells each body's position in each of them.
        readout: positions in normalised image units.
        bodies: number of bodies.
        half_extent: world units in half of the longer image side.
        follows_camera: whether the drift of a camera is to be taken out of the tracks.
        stride, side: of the frames that are read; see :class:`vidphys.data.video.ClipSelection`.
        mirrors: whether :meth:`closely` reads the mirror images of the frames as well. To the
            readout these are other pictures, so that much of its error averages out, at four
            times the cost.
    """

    encoder: LoadedEncoder
    readout: Readout
    bodies: int
    half_extent: float
    follows_camera: bool = False
    stride: int = 1
    side: int | None = None
    mirrors: bool = True

    def read(self, frames: Frames, times: np.ndarray) -> Tracks:
        """Tracks of a clip as it is seen, world units, as :meth:`closely` as the reader reads.

        Args:
            frames: RGB bytes ``(t, H, W, 3)``, row 0 on top.
            times: seconds of each.
        """
        return self.closely(self.look(frames, times), torch.tensor(times))

    def look(self, frames: Frames, times: np.ndarray) -> Callable[[Axes], FeatureMap]:
        """What gives the features of a clip's frames mirrored along some of their axes."""
        network, seconds = self.encoder.network, torch.tensor(times)
        size, layer = (frames.shape[1], frames.shape[2]), network.identity.layer

        def see(axes: Axes) -> FeatureMap:
            shown = partial(pictures, frames, axes)
            (found,) = stream(network, shown, size, seconds, [layer])
            # rounded as in a store and taken from a card, so that a clip is read as in training
            rounded = (moved(piece, CPU, STORED) for piece in found.pieces)
            return replace(found, pieces=rounded).whole()[layer]

        return see

    def tracks(self, features: FeatureMap, times: Tensor) -> Tracks:
        """Positions as they are seen, world units, of clips whose frames are at ``times``.

        Args:
            features: of ``b`` clips.
            times: seconds of each frame, ``(t,)``.
        """
        return self._averaged([self._look(features, ())], times)

    def closely(self, see: Callable[[Axes], FeatureMap], times: Tensor) -> Tracks:
        """As :meth:`tracks`, averaged over the frames and their mirror images.

        The confidence is that of one of them: the mean deserves somewhat more.

        Args:
            see: gives the features of the frames mirrored along some of their axes.
            times: seconds of each frame, ``(t,)``.
        """
        images = MIRRORS if self.mirrors else MIRRORS[:1]
        return self._averaged([self._look(see(axes), axes) for axes in images], times)

    def camera(self, frames: Frames) -> Tensor:
        """Displacement of the background in each frame ``(t, 2)``, world units."""
        if not self.follows_camera:
            return torch.zeros(len(frames), 2)
        return self.half_extent * camera_path(frames)

    def _look(self, features: FeatureMap, axes: Axes) -> tuple[Tensor, Tensor]:
        """Positions ``(b, t, n, 2)``, and the error expected of them, of mirrored frames."""
        values, centres = features.values.flatten(0, 1).cpu(), features.cell_centres().cpu()
        positions, confidence = read_all(self.readout, values, centres)
        sign = torch.tensor([-1.0 if axis in axes else 1.0 for axis in (ALONG_X, ALONG_Y)])
        whole = (len(features.values), -1, self.bodies)
        return (sign * positions).reshape(*whole, 2), distance_at(confidence).reshape(whole)

    def _averaged(self, looks: Sequence[tuple[Tensor, Tensor]], times: Tensor) -> Tracks:
        positions, distance = (torch.stack(each).mean(0) for each in zip(*looks, strict=True))
        sure = confidence_at(distance)
        # the last feature frame of a video encoder may stand for frames beyond the clip's end
        inside = slice(len(times))
        return Tracks(self.half_extent * positions[:, inside], sure[:, inside], times)


def steady(tracks: Tracks, camera: Tensor) -> Tracks:
    """Tracks as a camera without drift would have seen them; both in world units."""
    moved = tracks.positions - camera[None, :, None]
    return Tracks(moved, tracks.confidence, tracks.times)
