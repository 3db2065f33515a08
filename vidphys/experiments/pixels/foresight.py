"""Does a predictor of the next frame foresee more than that nothing will change?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

# Of the copy's error: a predictor above it foresees nothing, and probes of it are void.
BETTER = 0.9
CLIPS = 32  # at most, that are looked at
AT_ONCE = 4  # clips


class Foreseeing(Protocol):
    """See :class:`encoders.frozen.vjepa2_ac.VJEPA2ACEncoder`."""

    def see(self, clips: Tensor) -> Tensor: ...

    def foresee(self, seen: Tensor) -> Tensor: ...


@dataclass(frozen=True)
class Foresight:
    """Mean absolute distances of tokens.

    Args:
        missed: of what was foreseen from the next frame.
        copied: of each frame from the next one.
        unrelated: of each frame from the same frame of another clip.
    """

    missed: float
    copied: float
    unrelated: float

    @property
    def over_copy(self) -> float:
        """Error over that of copying the last frame."""
        return self.missed / self.copied

    @property
    def step(self) -> float:
        """How far a frame is from the next, over how far it is from an unrelated one."""
        return self.copied / self.unrelated

    @property
    def foresees(self) -> bool:
        """Whether the predictor is clearly better than the copy."""
        return self.over_copy < BETTER


def foresight(encoder: Foreseeing, frames: Tensor) -> Foresight:
    """Compare what an encoder's predictor says of each next frame with a copy of the last one.

    Args:
        encoder: sees frames and foresees the next ones.
        frames: bytes, ``(b, t, c, H, W)``, two clips and two frames or more.
    """
    few = frames[:CLIPS]
    # a last lot of one clip has no other clip
    lots = few.tensor_split(max(1, len(few) // AT_ONCE))
    with torch.inference_mode():
        parts = [_distances(encoder, lot) for lot in lots]
    return Foresight(*(sum(each) / len(parts) for each in zip(*parts, strict=True)))


def _distances(encoder: Foreseeing, frames: Tensor) -> tuple[float, float, float]:
    seen = encoder.see(frames.float() / 255)
    before, after = seen[:, :-1], seen[:, 1:]
    pairs = (encoder.foresee(before), after), (before, after), (seen, seen.roll(1, 0))
    missed, copied, unrelated = (float((a - b).abs().mean()) for a, b in pairs)
    return missed, copied, unrelated
