"""A free force beside the factored one, and how much of the work it does (inventory M14, K10)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dynamics.hamiltonian import Hamiltonian
from dynamics.mlp import MLP, TANH
from dynamics.potentials import Potential
from dynamics.state import Parameters, PhaseState


class Shortcut(nn.Module):
    """A factored potential, and any force at all of positions and parameters beside it.

    The free force need be no gradient, so it has no energy; :meth:`energy` is the potential's.

    Args:
        factored: the potential that the coupling multiplies.
        coordinates: entries of q.
        conditions: entries of the parameters' vector.
        width: of the free force's network.
    """

    def __init__(self, factored: Potential, coordinates: int, conditions: int, width: int) -> None:
        super().__init__()
        self.factored = factored
        self.free = MLP((coordinates + conditions, width, width, coordinates), TANH)

    def energy(self, q: Tensor, params: Parameters) -> Tensor:
        return self.factored.energy(q, params)

    def force(self, q: Tensor, params: Parameters) -> Tensor:
        return self.factored.force(q, params) + self.free_force(q, params)

    def free_force(self, q: Tensor, params: Parameters) -> Tensor:
        """What the shortcut adds, shape of ``q``."""
        return self.free(torch.cat([q.flatten(-2), params.flat], -1)).reshape(q.shape)


def shortcut_of(head: nn.Module) -> Shortcut:
    """The shortcut of a model that has one.

    Raises:
        ValueError: it has none.
    """
    if isinstance(head, Hamiltonian) and isinstance(head.potential, Shortcut):
        return head.potential
    raise ValueError(f"{type(head).__name__}: this model has no shortcut beside its pair law")


def shortcut_share(head: nn.Module, state: PhaseState, params: Parameters) -> Tensor:
    """|F_s| / (|F_s| + |F_f|) over a whole batch (inventory K10, 12.34), a scalar.

    Raises:
        ValueError: the model has no shortcut.
    """
    part = shortcut_of(head)
    free = part.free_force(state.q, params).norm()
    return free / (free + part.factored.force(state.q, params).norm())
