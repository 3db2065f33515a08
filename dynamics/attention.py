"""A set transformer: bodies as tokens, self-attention between them.

Lee et al., ICML 2019.
"""

from __future__ import annotations

import torch
from torch import nn
from torch.nn.attention import SDPBackend, sdpa_kernel

from dynamics.maps import TransitionMap
from dynamics.state import Parameters, PhaseState

LAYERS, HEADS, FEED_FORWARD = 2, 4, 34  # 89,640 parameters at width 96 in a plane


class SetTransformer(TransitionMap):
    """Permutation-equivariant increments; nothing of the pair law is built in.

    Args:
        space: dimensions of space.
        width: of a token.
        dt: seconds that one application stands for.
    """

    def __init__(self, space: int, width: int, dt: float) -> None:
        super().__init__(dt)
        self.embed = nn.Linear(2 * space + 2, width)
        self.layers = nn.ModuleList(
            nn.TransformerEncoderLayer(
                width, HEADS, FEED_FORWARD, dropout=0.0, batch_first=True, norm_first=True
            )
            for _ in range(LAYERS)
        )
        self.read = nn.Linear(width, 2 * space)

    def increment(self, state: PhaseState, params: Parameters) -> PhaseState:
        mass = params.mass.unsqueeze(-1)
        coupling = params.coupling[..., None, None].expand_as(mass)
        tokens = torch.cat([state.q, state.p, mass, coupling], -1)
        batch = tokens.shape[:-2]
        x = self.embed(tokens.reshape(-1, *tokens.shape[-2:]))
        with sdpa_kernel(SDPBackend.MATH):  # the fused one has no rule for stacked weights
            for layer in self.layers:
                x = layer(x)
        out = self.read(x).reshape(*batch, tokens.shape[-2], -1)
        half = out.shape[-1] // 2
        return PhaseState(out[..., :half], out[..., half:])
