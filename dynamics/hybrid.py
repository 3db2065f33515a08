"""A free force beside the factored one, and its share of the work (the study, appendix E)."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.activations import TANH
from dynamics.couplings import PairLaw
from dynamics.hamiltonian import Hamiltonian
from dynamics.mlp import MLP
from dynamics.pairs import pair_indices
from dynamics.potentials import REACH, SPREAD, Potential
from dynamics.state import Parameters, PhaseState


class Shortcut(nn.Module):
    """A factored potential, and beside it a force between pairs that may be anything.

    The free force reads where two bodies are, their masses and the coupling; nothing says how the
    coupling enters, and it need be no gradient, so it has no energy: :meth:`energy` is the
    potential's.

    Args:
        factored: the potential that the coupling multiplies.
        space: dimensions of space.
        width: of the free force's network.
        box: side of a periodic box in world units, or ``None``.
    """

    conservative = False

    def __init__(
        self, factored: Potential, space: int, width: int, box: float | None = None
    ) -> None:
        super().__init__()
        self.factored = factored
        self.law = PairLaw(box=box)
        self.free = MLP((space + 3, width, width, space), TANH)

    def energy(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b"]:
        return self.factored.energy(q, params)

    def force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.factored.force(q, params) + self.free_force(q, params)

    def free_force(self, q: Float[Tensor, "*b n d"], params: Parameters) -> Float[Tensor, "*b n d"]:
        """What the shortcut adds, shape of ``q``; action and reaction are equal."""
        i, j = pair_indices(q.shape[-2], q.device)
        apart = self.law.nearest(q.index_select(-2, i) - q.index_select(-2, j))
        u = SPREAD * apart / (REACH + (apart.square().sum(-1, keepdim=True) + 1e-6).sqrt())
        m_i = params.mass.index_select(-1, i).unsqueeze(-1)
        m_j = params.mass.index_select(-1, j).unsqueeze(-1)
        strength = params.coupling[..., None, None].expand_as(m_i)
        there = self.free(torch.cat([u, m_i, m_j, strength], -1))
        back = self.free(torch.cat([-u, m_j, m_i, strength], -1))
        push = 0.5 * (there - back)
        return torch.zeros_like(q).index_add(-2, i, push).index_add(-2, j, push, alpha=-1)


def shortcut_of(head: nn.Module) -> Shortcut:
    """The shortcut of a model that has one.

    Raises:
        ValueError: it has none.
    """
    if isinstance(head, Hamiltonian) and isinstance(head.potential, Shortcut):
        return head.potential
    raise ValueError(f"{type(head).__name__}: this model has no shortcut beside its pair law")


def shortcut_share(head: nn.Module, state: PhaseState, params: Parameters) -> Float[Tensor, ""]:
    """|F_s| / (|F_s| + |F_f|) over a whole batch, a scalar.

    Raises:
        ValueError: the model has no shortcut.
    """
    part = shortcut_of(head)
    free = part.free_force(state.q, params).norm()
    return free / (free + part.factored.force(state.q, params).norm())
