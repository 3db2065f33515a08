"""A flat wall that bodies bounce off, within a step and with the field that acts on them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.around import Around
from dynamics.findings import Finding, OverlapWarning, counted
from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import Memory
from dynamics.state import Parameters, PhaseState

MOST = 64  # bounces within a step


class Wall(nn.Module):
    """The half-space ``q . normal > place``, which no body enters.

    A step that ends behind the wall is taken back to where the body met it and ended after the
    bounce, under the force at its end: exact in a uniform field, first order in how the force
    changes on the way. A body that still is behind it after ``MOST`` bounces in a step lies at it.

    Args:
        place: along the normal, world units.
        restitution: speed across the wall after a bounce over that before it.
        normal: towards the wall, ``(d,)``, of any length above zero.

    Raises:
        ValueError: a restitution outside [0, 1], or a normal without a direction.

    Example:
        >>> floor = Wall(place=1.0, restitution=0.5, normal=[0.0, -1.0])  # at y = -1
        >>> fell = PhaseState(torch.tensor([[0.0, -1.25]]), torch.tensor([[0.0, -2.0]]))
        >>> up = floor.bounced(fell, torch.zeros(1, 2), torch.ones(1))
        >>> up.q.tolist(), up.p.tolist()
        ([[0.0, -0.875]], [[0.0, 1.0]])
    """

    normal: Tensor

    def __init__(self, place: float, restitution: float, normal: Sequence[float]) -> None:
        super().__init__()
        if not 0 <= restitution <= 1:
            raise ValueError(f"Wall: restitution must be within 0 and 1, got {restitution}")
        towards = torch.tensor(normal, dtype=torch.float64)
        if not float(towards.norm()) > 0:
            raise ValueError(f"Wall: the normal must point somewhere, got {tuple(normal)}")
        self.place, self.restitution = place, restitution
        self.register_buffer("normal", towards / towards.norm())

    def depth(self, q: Float[Tensor, "*b n d"]) -> Float[Tensor, "*b n"]:
        """How far behind the wall, ``(..., n, d) -> (..., n)``, world units."""
        return q @ self.normal.to(q) - self.place

    def bounced(
        self, state: PhaseState, force: Float[Tensor, "*b n d"], mass: Float[Tensor, "*b n"]
    ) -> PhaseState:
        """The state after the bounces of a step.

        Args:
            state: at the end of the step, as if there were no wall, ``(..., n, d)``.
            force: there, same shape.
            mass: ``(..., n)``.
        """
        normal, depth = self.normal.to(state.q), self.depth(state.q)
        v, a = state.p @ normal / mass, force @ normal / mass
        place, speed = depth, v
        for _ in range(MOST):
            hit = (place > 0) & (speed > 0)
            if not bool(hit.any()):
                break
            place, speed = self._back(place, speed, a, hit)
        lies = (place > 0) & (speed > 0)
        place, speed = torch.where(lies, 0, place), torch.where(lies, 0, speed)
        shift, push = (place - depth).unsqueeze(-1) * normal, (mass * (speed - v)).unsqueeze(-1)
        return PhaseState(state.q + shift, state.p + push * normal)

    def _back(self, depth: Tensor, v: Tensor, a: Tensor, hit: Tensor) -> tuple[Tensor, Tensor]:
        """Depth and speed after one bounce, where a body is behind the wall and goes on into it."""
        # in a uniform field the speed at the wall follows from energy, the time since from both
        met = (v.square() - 2 * a * depth).clamp_min(0).sqrt()
        since = 2 * depth / torch.where(hit, v + met, torch.ones_like(v))
        after = -self.restitution * met
        back, speed = (after + 0.5 * a * since) * since, after + a * since
        # a body that was pushed out of rest did not meet the wall, but for rounding
        bounces = met > 2 * torch.finfo(v.dtype).eps ** 0.5 * v
        back, speed = torch.where(bounces, back, 0), torch.where(bounces, speed, 0)
        return torch.where(hit, back, depth), torch.where(hit, speed, v)


class Walled(Around):
    """A Hamiltonian model beside a wall.

    Args:
        free: the model without the wall.
        wall: what its bodies bounce off.
    """

    def __init__(self, free: Hamiltonian, wall: Wall) -> None:
        super().__init__(free)
        self.wall = wall

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        state, memory = self.free.advance(state, params, dt, memory)
        if not bool((self.wall.depth(state.q) > 0).any()):
            return state, memory
        return self.wall.bounced(state, self.force(state, params), params.mass), None

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        found = super().concerns(params, start)
        if start is None:
            return found
        behind = (self.wall.depth(start.q) > 0).any(-1)
        if bool(behind.any()):
            text = f"Wall: bodies start behind it in {counted(behind)}; they bounce as they leave"
            found.append(Finding(OverlapWarning, text, behind, 0, term="Wall"))
        return found

    @property
    def conserves(self) -> bool:
        return self.free.conserves and self.wall.restitution == 1
