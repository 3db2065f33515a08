"""Two bodies that collide: momentum is kept, and speed is lost by a restitution."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.numbers import number
from dynamics.state import PhaseState

LATE = 1.5  # steps, within which bodies that are too near touched: on the way they may have slowed
TINY = 1e-12  # world units or their square: keeps roots and directions finite


class Contact(nn.Module):
    """Two bodies that never come nearer to each other than their reach.

    A step that ends with them nearer is taken back, on straight lines, to where they touched, and
    ended after the collision: exact where nothing accelerates them, first order where something
    does. Where they overlapped before the step, they part without being moved.

    Args:
        first, second: indices i and j of the bodies.
        reach: their distance as they touch, world units; on a line q_j - q_i times ``side``, which
            may be negative where bodies are not told by their middles.
        restitution: speed at which they part over that at which they met.
        rub: share of the speed across the line between them that a collision takes.
        side: on a line, 1 where the second lies ahead of the first, else -1.
        learned: whether reach and restitution are.

    Example:
        >>> contact = Contact(0, 1, reach=1.0, restitution=1.0)
        >>> met = PhaseState(torch.tensor([[[0.5], [1.0]]]), torch.tensor([[[1.0], [0.0]]]))
        >>> after = contact.collided(met, torch.tensor([[1.0, 1.0]]), dt=1.0)
        >>> after.q.flatten().tolist(), after.p.flatten().tolist()
        ([0.0, 1.5], [0.0, 1.0])
    """

    reach: Tensor
    restitution: Tensor
    rub: Tensor

    def __init__(
        self,
        first: int,
        second: int,
        reach: float,
        restitution: float,
        rub: float = 0.0,
        side: float = 1.0,
        learned: bool = False,
    ) -> None:
        super().__init__()
        self.first, self.second, self.side = first, second, side
        number(self, "reach", reach, learned)
        number(self, "restitution", restitution, learned)
        number(self, "rub", rub, learned=False)  # one collision hardly tells of it

    @property
    def elastic(self) -> bool:
        """Whether it keeps the energy."""
        return float(self.restitution) == 1 and float(self.rub) == 0

    def collided(self, state: PhaseState, mass: Float[Tensor, "*b n"], dt: float) -> PhaseState:
        """The state after a collision within the last step, where there was one.

        Args:
            state: at the end of the step, as if there were no contact, ``(..., n, d)``.
            mass: ``(..., n)``.
            dt: seconds of the step.
        """
        i, j = [self.first], [self.second]
        m_i, m_j = mass[..., i], mass[..., j]
        v_i, v_j = state.p[..., i, :] / m_i[..., None], state.p[..., j, :] / m_j[..., None]
        apart = (state.q[..., j, :] - state.q[..., i, :]).squeeze(-2)
        relative = (v_j - v_i).squeeze(-2)
        since, normal = self._touched(apart, relative, dt)
        across = (relative * normal).sum(-1, keepdim=True)
        hit = (since > 0) & (across < 0)
        rub, kept = self.rub.to(apart), self.restitution.to(apart)
        change = -(1 + kept - rub) * across * normal - rub * relative
        push = torch.where(hit, change / (1 / m_i + 1 / m_j), torch.zeros_like(change))
        moved = torch.where(hit, since, torch.zeros_like(since)) * push
        signs = torch.zeros(state.q.shape[-2], 1, dtype=apart.dtype, device=apart.device)
        signs[self.first], signs[self.second] = -1.0, 1.0
        q = state.q + signs * moved.unsqueeze(-2) / mass.unsqueeze(-1)
        return PhaseState(q, state.p + signs * push.unsqueeze(-2))

    def _touched(self, apart: Tensor, relative: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        """Seconds since they touched, 0 where they did not within the step; and the normal then."""
        reach = self.reach.to(apart)
        if apart.shape[-1] == 1:
            depth, closing = reach - self.side * apart, -self.side * relative
            since = torch.where(closing > 0, depth / closing.clamp_min(TINY), 0)
            normal = torch.full_like(apart, self.side)
            return self._within(since, dt), normal
        square = relative.square().sum(-1, keepdim=True)
        away = (apart * relative).sum(-1, keepdim=True)
        inside = away.square() - square * (apart.square().sum(-1, keepdim=True) - reach.square())
        root = inside.clamp_min(TINY**2).sqrt()
        since = torch.where(inside > 0, (away + root) / square.clamp_min(TINY), 0)
        touching = apart - since * relative
        size = touching.square().sum(-1, keepdim=True).clamp_min(TINY**2).sqrt()
        return self._within(since, dt), touching / size

    @staticmethod
    def _within(since: Tensor, dt: float) -> Tensor:
        return torch.where((since > 0) & (since <= LATE * dt), since, torch.zeros_like(since))
