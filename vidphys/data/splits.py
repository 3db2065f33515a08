"""What is trained on, what ends the training, and what is scored: whole clips, or parts of one.

Of several clips, the first are trained on, one in five of those decides when to stop, and the
others are scored. A single clip is cut in time: its first part is trained on, every fifth block
of that decides, and what comes after is scored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from vidphys.errors import InputError

BLOCK = 8  # frames
EVERY = 5  # one block, or clip, in so many


@dataclass(frozen=True)
class Split:
    """Of each clip in turn.

    Args:
        train, held_out, scored: numbers of its feature frames; empty ones for most clips.
        known: its frames, from the start, that heads may be fitted to; 0 for a scored clip.
        asked: its first frame that is foretold and scored; ``None`` where it is not.
        each: frames that a feature frame stands for.
    """

    train: tuple[Tensor, ...]
    held_out: tuple[Tensor, ...]
    scored: tuple[Tensor, ...]
    known: tuple[int, ...]
    asked: tuple[int | None, ...]
    each: int


def split_frames(frames: int, features: int, each: int, share: float) -> Split:
    """One clip, cut in time.

    Args:
        frames, features: of the clip, and of its features.
        each: frames that a feature frame stands for.
        share: of the clip, from its start, that is trained on.

    Raises:
        InputError: the share leaves nothing to train on or to score.
    """
    block = max(1, BLOCK // each)
    end = round(features * share)
    if not block * EVERY <= end < features:
        raise InputError(
            f"train share {share}: leaves {end * each} of {frames} frames to train on and "
            f"{max(0, frames - end * each)} to score; needs at least {block * EVERY * each} and "
            f"{each}"
        )
    number = torch.arange(end)
    held = (number // block) % EVERY == EVERY // 2
    scored = torch.arange(end, features)
    return Split((number[~held],), (number[held],), (scored,), (end * each,), (end * each,), each)


def split_clips(frames: Sequence[int], features: Sequence[int], each: int, share: float) -> Split:
    """Several clips; the second half of each scored one is foretold from its first.

    Args:
        frames, features: of each clip, and of its features.
        each: frames that a feature frame stands for.
        share: of the clips that is trained on, at least two; at least one is scored.

    Raises:
        InputError: too few clips for that.
    """
    count = len(frames)
    end = round(count * share)
    if not 2 <= end < count:
        raise InputError(
            f"train share {share}: leaves {end} of {count} clips to train on and {count - end} to "
            "score; needs at least two (one of them to stop by) and one"
        )
    held = {k for k in range(end) if k % EVERY == EVERY // 2} or {end - 1}
    train, held_out, scored, known, asked = [], [], [], [], []
    none = torch.arange(0)
    for k, (whole, cells) in enumerate(zip(frames, features, strict=True)):
        every = torch.arange(cells)
        train.append(every if k < end and k not in held else none)
        held_out.append(every if k in held else none)
        scored.append(every if k >= end else none)
        known.append(whole if k < end else 0)
        asked.append(whole - whole // 2 if k >= end else None)
    return Split(tuple(train), tuple(held_out), tuple(scored), tuple(known), tuple(asked), each)
