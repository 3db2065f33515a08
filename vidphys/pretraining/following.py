"""A teacher that follows its student slowly: an exponential moving average of the weights."""

from __future__ import annotations

import math

import torch
from torch import nn

FIRST_MOMENTUM = 0.99


def momentum(progress: float) -> float:
    """Share that the teacher keeps at each step: from ``FIRST_MOMENTUM`` to 1 along a cosine."""
    return 1 - (1 - FIRST_MOMENTUM) * 0.5 * (1 + math.cos(math.pi * progress))


@torch.no_grad()
def follow(teacher: nn.Module, student: nn.Module, kept: float) -> None:
    """Move the teacher's weights towards the student's, by ``1 - kept`` of the way."""
    for theirs, ours in zip(teacher.parameters(), student.parameters(), strict=True):
        theirs.lerp_(ours.to(theirs.dtype), 1 - kept)
