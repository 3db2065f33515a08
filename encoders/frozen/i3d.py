"""I3D, a 3-D convolutional video network trained on Kinetics-400 (arXiv:1705.07750), frozen.

Any stage is read; there is no classifier. Frames are resized as they are, RGB in [-1, 1], sides
multiples of 32, and their edges are continued by a cell in all: the network's receptive fields lie
up to half a cell to the lower right of their cells, and so they are brought back (to half a network
pixel).

One frame and any other number are followed by copies of the last one up to a multiple of the
stage's stride in time (2, 4 or 8); a clip shorter than a window makes a shorter window. A long clip
is seen in windows of ``frames`` frames, side by side unless ``hop`` is less, and a last one that
ends with the clip. A feature frame's time is that of the middle of its receptive field, no later
than the last frame.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from encoders.frozen.base import DTYPES, Dtype, FrozenEncoder
from encoders.frozen.i3d_network import STAGES, I3DNetwork, field_centre, field_stride
from encoders.frozen.tokens import chosen_layer, windowing_words
from encoders.frozen.untrained import fresh
from encoders.frozen.windows import Windowing
from encoders.preprocess import network_size, resize, to_rgb
from encoders.release import WeightsFile, load_strict
from encoders.weights import find_weights

NAME = "i3d"
CODE_VERSION = 1
MULTIPLE = 32
PREPROCESSING = (
    "rgb in -1..1, longer side to resolution, sides to multiples of 32, bilinear, edges continued"
)
Stage = Literal[
    "Conv3d_1a_7x7",
    "Conv3d_2b_1x1",
    "Conv3d_2c_3x3",
    "Mixed_3b",
    "Mixed_3c",
    "Mixed_4b",
    "Mixed_4c",
    "Mixed_4d",
    "Mixed_4e",
    "Mixed_4f",
    "Mixed_5b",
    "Mixed_5c",
]


@dataclass(frozen=True)
class I3DSettings:
    """What is read, and at which cost.

    Args:
        layer: the stage, by the release's name. ``Mixed_3c`` has 480 channels at stride (2, 8, 8)
            in (frames, pixels, pixels), ``Mixed_4f`` 832 at (4, 16, 16), ``Mixed_5c`` 1024 at
            (8, 32, 32). Later stages are not computed.
        resolution: network pixels of the longer image side, a multiple of 32.
        frames: in a window, a multiple of the stage's stride in time.
        hop: frames from a window's start to the next one's; ``frames`` where not given.
        frame_stride: take each so-many-th frame, before windows are made.
        shown: times that the network is shown each frame, one after the other; divides the stage's
            stride in time. A feature frame stands for as many frames fewer, and saw less of those
            before and after: 2 gives ``Mixed_3c`` and earlier stages one for each frame.
        seed: take weights that it draws, untrained, as a control; none need be on the machine.
        dtype: of the computation.
        batch: windows per forward pass.
    """

    layer: Stage = "Mixed_4f"
    resolution: int = 128
    frames: int = 16
    hop: int | None = None
    frame_stride: int = 1
    shown: int = 1
    seed: int | None = None
    dtype: Dtype = "float32"
    batch: int = 1


class I3DEncoder(FrozenEncoder):
    """Windows of frames to the maps of one stage.

    Args:
        network: see :class:`I3DNetwork`.
        settings: see :class:`I3DSettings`.
        weights: the file that the network was loaded from.

    Raises:
        ValueError: a stage, a resolution or a window that the network does not have, or frames
            shown so often that a feature frame would not stand for a whole number of them.
    """

    def __init__(self, network: I3DNetwork, settings: I3DSettings, weights: WeightsFile) -> None:
        stage = chosen_layer(NAME, settings.layer, STAGES)
        network_size(1, 1, settings.resolution, MULTIPLE)
        windowing = _windowing(settings, stage)
        words = windowing_words(windowing, settings.frame_stride)
        if settings.shown > 1:
            words += f", each frame shown {settings.shown} times"
        super().__init__(
            network,
            settings,
            windowing,
            STAGES,
            name=NAME,
            code_version=CODE_VERSION,
            weights_sha256=weights.sha256,
            preprocessing=f"{words}, {PREPROCESSING}",
            layer=stage,
            resolution=settings.resolution,
        )

    @property
    def sight(self) -> Hashable:
        """Stages of one stride see the same edges and the same windows."""
        return self.windowing, field_stride(self.identity.layer, 1)

    def at(self, layer: int | str) -> FrozenEncoder:
        other, stride = super().at(layer), self.settings.frame_stride
        other.windowing = _windowing(self.settings, other.identity.layer)
        own, others = (windowing_words(each.windowing, stride) for each in (self, other))
        told = self.identity.preprocessing.replace(own, others)
        other.identity = replace(other.identity, preprocessing=told)
        return other

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        stage = layers[0]
        height, width = clips.shape[-2:]
        size = network_size(height, width, self.settings.resolution, MULTIPLE)
        pixels = resize(to_rgb(clips.flatten(0, 1)), size) * 2 - 1
        cell = field_stride(stage, 1)
        # the field's centre less the cell's, which is half a pixel from a whole one
        front = int(field_centre(stage, 1) - (cell - 1) / 2 + 0.5)
        pads = (front, cell - front, front, cell - front)
        pixels = functional.pad(pixels, pads, mode="replicate").to(DTYPES[self.settings.dtype])
        pixels = pixels.unflatten(0, clips.shape[:2]).transpose(1, 2)
        found = self.network(pixels.repeat_interleave(self.settings.shown, 2), layers)
        inside = (..., slice(size[0] // cell), slice(size[1] // cell))
        return [maps[inside].transpose(1, 2) for maps in found]


def _windowing(settings: I3DSettings, stage: str) -> Windowing:
    """How the network samples time, in frames of the clip."""
    stride, shown = field_stride(stage, 0), settings.shown
    if shown < 1 or stride % shown:
        raise ValueError(
            f"i3d: {stage} strides over {stride} frames, so that each can be shown 1 to "
            f"{stride} times, a number that divides it; got {shown}"
        )
    # the middle of what the network sees there, of which each frame is so many parts
    centre = (field_centre(stage, 0) + 0.5) / shown - 0.5
    return Windowing(settings.frames, settings.hop, stride // shown, centre, shortens=True)


def load_i3d(settings: I3DSettings, where: Path | None = None, device: str = "cpu") -> I3DEncoder:
    """The frozen encoder from its weights on disk, strictly (see ``load_encoder``)."""
    if settings.seed is not None:
        network, weights = fresh(I3DNetwork, settings.seed)
    else:
        network, weights = I3DNetwork(), find_weights(NAME, where)
        load_strict(network, weights.path, unused=("logits.",))
    return I3DEncoder(network.to(device), settings, weights)
