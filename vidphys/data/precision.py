"""Whether an encoder is faster in bfloat16 on this machine, and what that costs."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np
import torch
from torch import Tensor

from encoders.identity import LayeredEncoder
from vidphys.data.video import Video

EXACT, SHORT = "float32", "bfloat16"
FRAMES = 16  # of a clip, that are tried


@dataclass(frozen=True)
class Precision:
    """What was measured on a few frames of a clip.

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
        video: whose first frames are tried.
    """
    block = np.stack([*islice(video.frames, FRAMES)])
    frames = torch.from_numpy(block).permute(0, 3, 1, 2)[None]
    times = torch.from_numpy(video.times[: len(block)])
    seconds, values, encoders = {}, {}, {}
    for dtype in (EXACT, SHORT):
        encoder = encoders[dtype] = load(dtype)
        encoder.encode_layers(frames, times, layers)  # the first takes longer
        begun = time.perf_counter()
        values[dtype] = encoder.encode_layers(frames, times, layers)
        seconds[dtype] = time.perf_counter() - begun
    exact, short = (values[dtype] for dtype in (EXACT, SHORT))
    away = [_away(short[layer].values, exact[layer].values) for layer in exact]
    ratio = seconds[EXACT] / seconds[SHORT]
    return Precision(encoders[SHORT if ratio > 1 else EXACT], ratio, max(away))


def _away(found: Tensor, exact: Tensor) -> float:
    return float((found - exact).norm() / exact.norm().clamp_min(1e-12))
