"""A discovered latent whose momentum is its own, and the term that ties it to what is seen.

In the discovered rung momentum is a difference of positions by construction. Here the encoder says
both halves of the state, and prediction alone gives the second one its meaning, unless a term asks
it to be consistent with the velocity that is observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from einops import rearrange
from torch import Tensor, nn

from dynamics import Head, PhaseState
from readouts.differencing import central_difference
from renderers import ChannelWorld
from vidphys.perception.base import FitTask
from vidphys.perception.cnn import CnnPerception
from vidphys.perception.discovered import SEEN, Discovery, DiscoverySettings, discover
from vidphys.perception.windows import Window
from vidphys.shooting.step import HEAD_DT


@dataclass(frozen=True)
class FreeMomentumSettings:
    """Of a latent that says both halves of the state.

    Args:
        discovery: of the encoder's and the head's training.
        width: of the momentum network.
    """

    discovery: DiscoverySettings = DiscoverySettings()
    width: int = 64


class FreeMomentum(Discovery):
    """Encoder, momentum network and head, trained by one loss.

    Args:
        perception, head, world, every, steps, settings: see :class:`Discovery`.
        weight: of the consistency term, 0 for none.
        width: of the momentum network.
    """

    def __init__(
        self,
        perception: CnnPerception,
        head: Head,
        world: ChannelWorld,
        every: int,
        steps: int,
        weight: float,
        settings: DiscoverySettings = FreeMomentumSettings.discovery,
        width: int = FreeMomentumSettings.width,
    ) -> None:
        super().__init__(perception, head, world, every, steps, settings)
        self.weight = weight
        self.momentum = nn.Sequential(nn.Linear(2 * SEEN, width), nn.SiLU(), nn.Linear(width, 2))

    def states(self, positions: Tensor) -> PhaseState:
        """The latent at the middle one of three frames, ``(m, n, 2)``, from ``(m, 3, n, 2)``."""
        stack = rearrange(positions, "m t n d -> m n (t d)")
        return PhaseState(positions[:, SEEN // 2], self.momentum(stack))

    def loss(self, window: Window) -> Tensor:
        """Prediction error, and the mean squared p / m - v, over the mean squared observed v."""
        positions = self.perception.locate(window.frames[:, :SEEN])
        latent = self.states(positions)
        mass = window.params.mass
        seen = central_difference(positions.detach(), torch.ones_like(mass), self.every * HEAD_DT)
        velocity = seen.p[:, 0]
        off = (latent.p / mass[..., None] - velocity).square().mean()
        consistency = off / velocity.square().mean().clamp_min(1e-12)
        return self.error(latent, window) + self.weight * consistency


def fit_free_momentum(
    task: FitTask, weight: float, settings: FreeMomentumSettings = FreeMomentumSettings()
) -> FreeMomentum:
    """Train encoder, momentum and head by predicting future frames.

    Args:
        task: what is trained on; see :func:`discover` for what is refused.
        weight: of the consistency term, 0 for none.
    """
    name = f"free-momentum-{weight:g}-{task.head}"
    make = partial(FreeMomentum, weight=weight, width=settings.width)
    return discover(task, name, make, settings.discovery).eval()
