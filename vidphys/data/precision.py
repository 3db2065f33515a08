"""What fewer bits of an encoder's arithmetic cost, and whether they are faster on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import torch
from torch import Tensor

from encoders.features import FeatureMap
from encoders.identity import LayeredEncoder
from vidphys.data.video import Video

EXACT, SHORT = "float32", "bfloat16"
FRAMES = 16  # of a clip, that are tried at least


@dataclass(frozen=True)
class Precision:
    """What was measured on the first window of a clip.

    Args:
        encoder: the faster one.
        ratio: speed in bfloat16 to that in float32.
        error: of features in bfloat16, relative, in the worst layer.
    """

    encoder: LayeredEncoder
    ratio: float
    error: float

    @property
    def short(self) -> bool:
        """Whether it is bfloat16."""
        return self.ratio > 1

    def __str__(self) -> str:
        chosen = SHORT if self.short else EXACT
        return (
            f"{chosen}: bfloat16 has {self.ratio:.2g} times the speed of float32 here, and a "
            f"feature error of {self.error:.2g}"
        )


def faster(load: Callable[[str], LayeredEncoder], layers: Sequence[str], video: Video) -> Precision:
    """The encoder in float32 or in bfloat16, whichever takes less time on this machine.

    Args:
        load: the encoder in a precision.
        layers: that are read.
        video: whose first window is tried.
    """
    seconds, values, encoders = {}, {}, {}
    for dtype in (EXACT, SHORT):
        encoder = encoders[dtype] = load(dtype)
        frames, times = _first_window(encoder, video)
        encoder.encode_layers(frames, times, layers)  # the first takes longer
        begun = time.perf_counter()
        values[dtype] = encoder.encode_layers(frames, times, layers)
        seconds[dtype] = time.perf_counter() - begun
    ratio = seconds[EXACT] / seconds[SHORT]
    away = _away(values[SHORT], values[EXACT])
    return Precision(encoders[SHORT if ratio > 1 else EXACT], ratio, away)


def error_of(
    encoder: LayeredEncoder,
    load: Callable[[str], LayeredEncoder],
    layers: Sequence[str],
    video: Video,
) -> float:
    """The error of an encoder's features against those in float32, relative, in the worst layer.

    Args:
        encoder: that computes in fewer bits.
        load: the same in a precision.
        layers: that are read.
        video: whose first window is tried.
    """
    seen = _first_window(encoder, video)
    exact = load(EXACT).encode_layers(*seen, layers)
    return _away(encoder.encode_layers(*seen, layers), exact)


def _first_window(encoder: Any, video: Video) -> tuple[Tensor, Tensor]:
    """Frames and their times."""
    windowing = getattr(encoder, "windowing", None)
    window = encoder.frame_stride * windowing.frames if windowing else 0
    block = np.stack([*islice(video.frames, max(FRAMES, window))])
    frames = torch.from_numpy(block).permute(0, 3, 1, 2)[None]
    return frames, torch.from_numpy(video.times[: len(block)])


def _away(found: Mapping[str, FeatureMap], exact: Mapping[str, FeatureMap]) -> float:
    """Three digits: the rest may differ from one machine to the next."""
    worst = 0.0
    for layer, features in exact.items():
        lost = (found[layer].values - features.values).norm()
        worst = max(worst, float(lost / features.values.norm().clamp_min(1e-12)))
    return float(f"{worst:.3g}")
