"""Models whose law changes with time: by a clock that is told, and goes on as they are stepped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import cast

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.around import Around
from dynamics.hamiltonian import Hamiltonian
from dynamics.integrators import Memory
from dynamics.numbers import number
from dynamics.ports import turned
from dynamics.state import CLOCK, Parameters, PhaseState


class Timed(nn.Module):
    """What acts on the momenta by the clock, beside Hamilton's equations."""

    def kick(
        self, p: Float[Tensor, "*b n d"], mass: Float[Tensor, "*b n"], clock: Tensor, dt: float
    ) -> Float[Tensor, "*b n d"]:
        """Momenta after ``dt`` seconds of this alone.

        Args:
            p: momenta before.
            mass: of the bodies.
            clock: seconds that it shows before, of each episode.
            dt: seconds.
        """
        raise NotImplementedError


class Sinusoid(Timed):
    """dv/dt = along cos(rate t) + across sin(rate t), stepped exactly; t is what the clock shows.

    Args:
        along, across: accelerations ``(d,)``, world units per second squared.
        rate: radians per second.
        learned: whether all three are.

    Example:
        >>> push = Sinusoid((1.0,), (0.0,), torch.pi, learned=False)
        >>> rest = torch.zeros(1, 1, dtype=torch.float64)
        >>> push.kick(rest, torch.ones(1), torch.zeros(()), dt=0.5).item() * torch.pi
        1.0
    """

    along: Tensor
    across: Tensor
    rate: Tensor

    def __init__(
        self, along: Sequence[float], across: Sequence[float], rate: float, learned: bool = True
    ) -> None:
        super().__init__()
        for name, value in (("along", along), ("across", across), ("rate", rate)):
            number(self, name, value, learned)

    def kick(
        self, p: Float[Tensor, "*b n d"], mass: Float[Tensor, "*b n"], clock: Tensor, dt: float
    ) -> Float[Tensor, "*b n d"]:
        rate = self.rate.to(p)
        angle = (rate * (clock.to(p) + dt / 2))[..., None, None]
        mean = torch.sinc(rate * dt / (2 * torch.pi))  # over the time, of a sinusoid about it
        push = angle.cos() * self.along.to(p) + angle.sin() * self.across.to(p)
        return p + dt * mean * (mass.unsqueeze(-1) * push)


class Lift(Timed):
    """dp/dt = rate exp(-fades t) J p in the plane, J a quarter turn, stepped exactly: what spins is
    pushed across its way by the air (Magnus effect), and less as its spin fades.

    Args:
        rate: radians per second where the clock shows 0.
        fades: share of it a second by which the spin fades, which is known.
        learned: whether the rate is.
    """

    rate: Tensor

    def __init__(self, rate: float, fades: float, learned: bool = True) -> None:
        super().__init__()
        self.fades = fades
        number(self, "rate", rate, learned)

    def kick(
        self, p: Float[Tensor, "*b n d"], mass: Float[Tensor, "*b n"], clock: Tensor, dt: float
    ) -> Float[Tensor, "*b n d"]:
        lasts = -math.expm1(-self.fades * dt) / self.fades if self.fades else dt
        angle = self.rate.to(p) * torch.exp(-self.fades * clock.to(p)) * lasts
        return turned(p, angle[..., None, None])


class Clocked(Around):
    """A model beside which something acts that changes with time.

    Half of it acts before a step of the model within and half after (Strang splitting, second
    order). The scalar ``clock`` of the parameters is what the clock shows at the start, in seconds;
    :meth:`dynamics.Parameters.later` sets it on.

    Args:
        free: the model without it.
        timed: what acts, in this order.

    Example:
        >>> from dynamics import build, terms
        >>> swing = terms.Hamiltonian(potentials=(terms.Trap(4.0),))
        >>> motor = terms.Sinusoid(along=(0.5,), across=(0.0,), rate=3.0)
        >>> head = build(terms.Clocked(swing, (motor,)), bodies=1, dt=0.01, space=1)
        >>> start = PhaseState(torch.zeros(1, 1, 1), torch.zeros(1, 1, 1))
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1)).with_scalar("clock", 0.0)
        >>> bool(head.advance(start, law, dt=0.01)[0].p > 0)
        True
    """

    def __init__(self, free: Hamiltonian, timed: Sequence[Timed]) -> None:
        super().__init__(free)
        self.timed = nn.ModuleList(timed)

    def advance(
        self, state: PhaseState, params: Parameters, dt: float, memory: Memory = None
    ) -> tuple[PhaseState, Memory]:
        gone, within = (0.0, None) if memory is None else memory
        state = self._kicked(state, params.later(gone), dt / 2)
        # What acts has moved p since the last step: only a force that ignores p can be re-used.
        kept = within if self.free.integrator.needs_separable else None
        state, within = self.free.advance(state, params, dt, kept)
        return self._kicked(state, params.later(gone + dt / 2), dt / 2), (gone + dt, within)

    def _kicked(self, state: PhaseState, params: Parameters, dt: float) -> PhaseState:
        p, clock = state.p, params.scalar(CLOCK)
        for part in self.timed:
            p = cast(Timed, part).kick(p, params.mass, clock, dt)
        return PhaseState(state.q, p)

    def check(self, params: Parameters) -> None:
        if CLOCK not in params.scalars:
            raise ValueError(
                "Clocked: this law changes with time; say what the clock shows at the start, in "
                "seconds: params.with_scalar('clock', 0.0)"
            )
        super().check(params)
