"""Hard disks on a torus, moved from collision to collision.

Alder and Wainwright, J. Chem. Phys. 31, 459 (1959).
"""

from __future__ import annotations

import math
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.couplings import PairLaw
from dynamics.domain import EXTENTS, NEAREST, extents
from dynamics.findings import Finding, OverlapWarning, counted
from dynamics.head import Head
from dynamics.integrators import Memory
from dynamics.pairs import pair_indices
from dynamics.state import Parameters, PhaseState, kinetic_energy

TOUCHING = 1e-6  # of the diameter: an overlap that rounding leaves after a bounce
MAX_EVENTS = 10_000  # of one piece of a step; more means that bodies are jammed


class HardDisks(Head):
    """Straight flight, and an exact bounce where two disks touch.

    Momentum and energy are conserved to rounding: each bounce turns the relative velocity of one
    pair, in its centre of mass, and changes nothing else.

    Args:
        box: side of the periodic box, world units.
        diameter: distance at which two disks touch, world units; the first guess of a learned one.
        learned: whether the diameter is learned.

    Raises:
        ValueError: a diameter outside (0, box / 2).

    Example:
        >>> from dynamics.rolling import rollout
        >>> q = torch.tensor([[[-0.5, 0.0], [0.5, 0.0]]], dtype=torch.float64)
        >>> p = torch.tensor([[[1.0, 0.0], [0.0, 0.0]]], dtype=torch.float64)
        >>> law = Parameters(torch.ones(1).double(), torch.ones(1, 2).double())
        >>> found = rollout(HardDisks(box=4.0, diameter=0.5), PhaseState(q, p), law, 10, 0.1)
        >>> found.at(-1).p.flatten().round(decimals=6).tolist()  # the momentum is handed over
        [0.0, 0.0, 1.0, 0.0]
    """

    def __init__(self, box: float, diameter: float, learned: bool = False) -> None:
        super().__init__()
        if not 0 < diameter < box / 2:
            raise ValueError(
                f"HardDisks: needs 0 < diameter < box / 2 = {box / 2:g}, got {diameter}"
            )
        self.law = PairLaw("alike", box=box)
        start = math.log(diameter)
        if learned:
            self.raw_diameter: Tensor = nn.Parameter(torch.tensor(start))
        else:
            self.register_buffer("raw_diameter", torch.tensor(start, dtype=torch.float64))

    @property
    def diameter(self) -> Tensor:
        """Distance at which two disks touch, world units; positive by construction."""
        return self.raw_diameter.exp()

    @property
    def box(self) -> float:
        return float(cast(float, self.law.box))

    @property
    def conserves(self) -> bool:
        return True

    @property
    def depends_on(self) -> tuple[str, ...]:
        return ()  # a diameter is all that is learned

    def concerns(self, params: Parameters, start: PhaseState | None = None) -> list[Finding]:
        if start is None or start.q.shape[-2] < 2:
            return []
        closest = 1 / extents(start, self.box)[..., EXTENTS.index(NEAREST)]
        episodes = closest < (1 - TOUCHING) * self.diameter
        if not bool(episodes.any()):
            return []
        text = (
            f"HardDisks: disks of diameter {float(self.diameter):.3g} overlap in "
            f"{counted(episodes)}: they leave each other without a bounce"
        )
        return [Finding(OverlapWarning, text, episodes, 0, term="HardDisks")]

    def energy(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b"]:
        """The kinetic energy: disks that do not overlap have no other."""
        return kinetic_energy(state.p, params.mass)

    def force(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        """Zero: between collisions there is none, and a collision has no finite one."""
        return torch.zeros_like(state.p)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        """Fly ``dt`` seconds through all collisions on the way.

        Raises:
            ValueError: ``dt`` < 0; turn the momenta round instead.
            RuntimeError: the bodies are jammed: collisions do not end.
        """
        if dt < 0:
            raise ValueError(f"HardDisks: dt must be >= 0, got {dt:g}; reverse the momenta instead")
        if not state.q.shape[-2]:
            return state, memory
        # Only the nearest image of a pair is looked at: no pair may cross what lies beyond it.
        speed = float((state.p.norm(dim=-1) / params.mass).amax())
        room = self.box / 2 - float(self.diameter)
        pieces = max(1, math.ceil(2 * speed * dt / room)) if math.isfinite(speed) else 1
        for _ in range(pieces):
            state = self._fly(state, params, dt / pieces)
        return state, memory

    def _fly(self, state: PhaseState, params: Parameters, dt: float) -> PhaseState:
        left = torch.full(state.q.shape[:-2], dt, dtype=state.q.dtype, device=state.q.device)
        mass = params.mass.unsqueeze(-1)
        if state.q.shape[-2] == 1:  # nothing to collide with
            return PhaseState(state.q + dt * state.p / mass, state.p)
        for _ in range(MAX_EVENTS):
            times, _ = self.collision_times(state, params)
            first, pair = times.min(-1)
            hit = first < left
            # A pair that overlaps by rounding has a time just below zero.
            step = torch.where(hit, first, left)
            state = PhaseState(state.q + step[..., None, None] * state.p / mass, state.p)
            if not bool(hit.any()):
                return state
            state = PhaseState(state.q, self._bounced(state, params, pair, hit))
            left = left - step
        raise RuntimeError(
            f"HardDisks: more than {MAX_EVENTS} collisions in {dt:g} s; the disks are jammed, "
            "use fewer or smaller ones"
        )

    def collision_times(self, state: PhaseState, params: Parameters) -> tuple[Tensor, Tensor]:
        """Seconds until each pair touches, ``(..., pairs)``, infinite where it never does.

        Also the discriminant of the quadratic equation, >= 0 where the lines of flight meet.
        """
        i, j = pair_indices(state.q.shape[-2], state.q.device)
        v = state.p / params.mass.unsqueeze(-1)
        apart = self.law.nearest(state.q[..., i, :] - state.q[..., j, :])
        relative = v[..., i, :] - v[..., j, :]
        b = (apart * relative).sum(-1)
        c = apart.square().sum(-1) - self.diameter.to(apart).square()
        discriminant = b.square() - relative.square().sum(-1) * c
        # The earlier root of |apart + relative t| = diameter, in the form without cancellation.
        root = discriminant.clamp_min(torch.finfo(b.dtype).tiny).sqrt()
        meets = (b < 0) & (discriminant > 0)
        time = c / torch.where(meets, root - b, torch.ones_like(b))
        return torch.where(meets, time, torch.full_like(b, torch.inf)), discriminant

    def _bounced(self, state: PhaseState, params: Parameters, pair: Tensor, hit: Tensor) -> Tensor:
        """Momenta after the bounce of one pair in each episode where ``hit`` holds."""
        first, second = pair_indices(state.q.shape[-2], state.q.device)
        i, j = first[pair].unsqueeze(-1), second[pair].unsqueeze(-1)

        def of(x: Tensor, body: Tensor) -> Tensor:
            index = body.unsqueeze(-1).expand(*body.shape, x.shape[-1])
            return x.gather(-2, index).squeeze(-2)

        mass = params.mass.unsqueeze(-1)
        m_i, m_j = of(mass, i), of(mass, j)
        normal = self.law.nearest(of(state.q, i) - of(state.q, j))
        push = bounce(normal, of(state.p, i) / m_i - of(state.p, j) / m_j, m_i, m_j)
        push = torch.where(hit.unsqueeze(-1), push, torch.zeros_like(push)).unsqueeze(-2)
        spread = torch.zeros_like(state.p)
        shape = (*i.shape, state.p.shape[-1])
        return (
            state.p
            + spread.scatter(-2, i.unsqueeze(-1).expand(shape), push)
            - spread.scatter(-2, j.unsqueeze(-1).expand(shape), push)
        )


def bounce(normal: Tensor, relative: Tensor, m_i: Tensor, m_j: Tensor) -> Tensor:
    """Momentum that body i gains and body j loses in an elastic collision, ``(..., d)``.

    Args:
        normal: q_i - q_j, of any length, ``(..., d)``.
        relative: v_i - v_j, ``(..., d)``.
        m_i, m_j: masses, ``(..., 1)``.
    """
    along = (relative * normal).sum(-1, keepdim=True) / normal.square().sum(-1, keepdim=True)
    return -2 * m_i * m_j / (m_i + m_j) * along * normal
