"""Friction that opposes velocity, stepped by exact flows, for free bodies and for joints.

dp_i/dt = -gamma phi(dq_i/dt) with phi(v) = v (linear), |v| v (square) or v / |v| (dry), for a
body's velocity vector or a joint's rate. No step size can make a gamma >= 0 add energy: each flow
is exact, and coupled joints are done one at a time, each at the rate that the others leave it.
Port-Hamiltonian friction: Desai et al., Phys. Rev. E 104, 034312 (2021).
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor, nn

from dynamics.numbers import unbent
from dynamics.ports import SLOW, Port
from dynamics.state import Parameters, PhaseState


def _linear(rate: Tensor, speed: Tensor) -> Tensor:
    """Fraction by which a speed has changed after rate = gamma t / m."""
    return torch.expm1(-rate).expand_as(rate * speed)


def _square(rate: Tensor, speed: Tensor) -> Tensor:
    """The same under |v| v; a negative gamma drives any speed to infinity in finite time."""
    left = 1 + rate * speed
    return torch.where(left > 0, 1 / left - 1, torch.inf)


def _dry(rate: Tensor, speed: Tensor) -> Tensor:
    """The same where the resistance does not depend on the speed: it stops a body for good."""
    floor = torch.finfo(speed.dtype).tiny
    return -(rate / speed.clamp_min(floor)).clamp(max=1.0)


FLOWS: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "linear": _linear,
    "square": _square,
    "dry": _dry,
}

TOLD = ("factored", "guaranteed", "known")
STRENGTHS = ("positive", "free", *TOLD)


class Friction(Port):
    """Friction of one law and one coefficient.

    Args:
        law: ``linear``, ``square`` or ``dry``.
        strength: what gamma is: a learned number that is ``positive`` by construction or
            ``free`` in sign; a learned positive multiple of the scalar ``friction`` that the
            episode is told (``factored``); the same, refusing a negative one (``guaranteed``);
            or that scalar itself, nothing learned (``known``).
        rate: where a learned gamma, or multiple of the one told, starts; above zero but for
            ``free``.

    Raises:
        ValueError: an unknown law or strength.

    Example:
        >>> drag = Friction("square", "known")
        >>> law = Parameters(torch.ones(1), torch.ones(1, 1)).with_scalar("friction", 0.5)
        >>> drag.force(torch.tensor([[[2.0, 0.0]]]), law).tolist()  # -0.5 |v| v
        [[[-2.0, -0.0]]]
    """

    def __init__(
        self, law: str = "linear", strength: str = "positive", rate: float | None = None
    ) -> None:
        super().__init__()
        for what, known, name in (("law", FLOWS, law), ("strength", STRENGTHS, strength)):
            if name not in known:
                raise ValueError(f"Friction: unknown {what} '{name}'; use {', '.join(known)}")
        self.law, self.strength = law, strength
        if strength != "known":
            # A multiple of what is told starts near one, a rate of its own starts slow.
            start = SLOW if strength == "positive" else 0.0
            self.raw = nn.Parameter(torch.tensor(start))
            if rate is not None:
                self.set(rate)

    def set(self, gamma: float) -> None:
        """Let a learned coefficient, or multiple of the one told, be this."""
        with torch.no_grad():
            start = torch.tensor(gamma, device=self.raw.device)
            self.raw.copy_(start if self.strength == "free" else unbent(gamma))

    def coefficient(self, params: Parameters) -> Tensor:
        """The coefficient gamma of each episode, ``(...)``, or ``()`` where all have the same."""
        if self.strength == "free":
            return self.raw
        if self.strength == "positive":
            return nn.functional.softplus(self.raw)
        told = params.scalar("friction")
        if self.strength == "known":
            return told
        if self.strength == "guaranteed":
            told = told.clamp_min(0)
        return nn.functional.softplus(self.raw) * told

    def check(self, params: Parameters) -> None:
        """Refuse what the guarantee cannot mean.

        Raises:
            ValueError: a guaranteed port is told of a negative friction.
        """
        if self.strength == "guaranteed" and bool((params.scalar("friction") < 0).any()):
            lowest = float(params.scalar("friction").min())
            raise ValueError(
                f"Friction: a guaranteed port can only take energy, but is told friction = "
                f"{lowest:g} < 0; use a factored or a sign-free port for anti-friction"
            )

    def force(
        self, velocity: Float[Tensor, "*b n d"], params: Parameters
    ) -> Float[Tensor, "*b n d"]:
        """-gamma phi(v), ``(..., n, d)``."""
        pull = -self.coefficient(params)[..., None, None] * velocity
        if self.law == "linear":
            return pull
        speed = velocity.norm(dim=-1, keepdim=True)
        if self.law == "square":
            return pull * speed
        return pull / speed.clamp_min(torch.finfo(speed.dtype).tiny)

    def kick(self, state: PhaseState, params: Parameters, dt: float) -> Float[Tensor, "*b n d"]:
        """Momenta after ``dt`` seconds, of bodies whose velocity is p / m, ``(..., n, d)``."""
        mobility = 1 / params.mass.unsqueeze(-1)
        rate = self.coefficient(params)[..., None, None] * mobility * dt
        speed = (state.p * mobility).norm(dim=-1, keepdim=True)
        return state.p + state.p * FLOWS[self.law](rate, speed)

    def drift(self, state: PhaseState, params: Parameters) -> Float[Tensor, "*b n d"]:
        return self.force(state.p / params.mass.unsqueeze(-1), params)

    def resist(self, p: Tensor, mobility: Tensor, params: Parameters, dt: float) -> Tensor:
        """Momenta of coupled joints after ``dt`` seconds at a fixed configuration, ``(..., n)``.

        Args:
            p: ``(..., n)``.
            mobility: M(q)^-1, ``(..., n, n)``.
            params: as for :meth:`kick`.
            dt: seconds.
        """
        gamma, joints = self.coefficient(params), p.shape[-1]
        units = torch.eye(joints, dtype=p.dtype, device=p.device)
        # There and back, half a step each: symmetric in time, hence of second order.
        for joint in (*range(joints - 1), joints - 1, *reversed(range(joints - 1))):
            share = dt if joint == joints - 1 else dt / 2
            own = mobility[..., joint, joint]
            v = (mobility[..., joint, :] * p).sum(-1)
            change = v * FLOWS[self.law](gamma * own * share, v.abs())
            p = p + (change / own).unsqueeze(-1) * units[joint]
        return p
