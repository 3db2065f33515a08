"""What decode-free joint-embedding training needs: a slow target, and an eye on collapse."""

from __future__ import annotations

import copy
import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

MOMENTUM = 0.996


class EmaTarget(nn.Module):
    """A copy of a module that follows it slowly and is never trained itself
    (Grill et al., NeurIPS 2020).

    The momentum rises from ``first`` to 1 along a half cosine, so that the target comes to rest. In
    the first updates it is (1 + k) / (10 + k) where that is lower: the random start is forgotten.

    Args:
        online: the module that is followed; its current weights are copied.
        updates: of the whole training, for the schedule.
        first: momentum at its start.
    """

    updated: Tensor

    def __init__(self, online: nn.Module, updates: int, first: float = MOMENTUM) -> None:
        super().__init__()
        self.updates, self.first = updates, first
        self.module = copy.deepcopy(online).requires_grad_(False)
        self.register_buffer("updated", torch.zeros((), dtype=torch.long))

    @property
    def momentum(self) -> float:
        """Share of the target that the next update leaves."""
        done = int(self.updated)
        scheduled = ema_momentum(done / max(1, self.updates), self.first)
        return min(scheduled, (1 + done) / (10 + done))

    @torch.no_grad()
    def update(self, online: nn.Module) -> None:
        """Move the target towards ``online``, of the same architecture as at the start."""
        follow(self.module, online, self.momentum)
        self.updated += 1


@torch.no_grad()
def follow(target: nn.Module, online: nn.Module, kept: float) -> None:
    """Move the weights of one module towards another's, by ``1 - kept`` of the way."""
    for own, other in zip(target.parameters(), online.parameters(), strict=True):
        own.lerp_(other, 1 - kept)


def ema_momentum(progress: float, first: float = MOMENTUM) -> float:
    """``first`` at the start of the training, 1 at its end (progress 1) and after."""
    return 1 - (1 - first) * (1 + math.cos(math.pi * min(progress, 1.0))) / 2


def variance_floor(latents: Float[Tensor, "*b n d"]) -> float:
    """The collapse monitor: the smallest variance that any coordinate has over a batch.

    Zero means that at least one coordinate says the same whatever is seen.
    """
    return float(latents.flatten(0, -3).var(0, correction=0).amin())
