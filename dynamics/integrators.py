"""Fixed-step integrators, as functions of a vector field.

``method(field, state, dt)`` advances a state by ``dt`` seconds. ``method.advance`` does the same
and also hands over what the next step can re-use (the last force for leapfrog, the shadow copy
for Tao's scheme), so that leapfrog costs one force evaluation a step.

References: Hairer, Lubich & Wanner, *Geometric Numerical Integration* (2006) for leapfrog and the
implicit midpoint rule; Yoshida, Phys. Lett. A 150 (1990); Kahan & Li, Math. Comp. 66 (1997) for the
eighth order; Tao, Phys. Rev. E 94, 043303 (2016).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from dynamics.state import PhaseState

Memory = Any


@dataclass(frozen=True)
class VectorField:
    """Hamilton's equations of one system with its parameters bound.

    Args:
        velocity: ``(q, p) -> dq/dt``, both ``(..., n, d)``.
        force: ``(q, p) -> dp/dt``.
        separable: whether velocity ignores q and force ignores p (H = T(p) + V(q)).
        both: ``(q, p) -> (dq/dt, dp/dt)``, where it is cheaper to compute them together.

    Example:
        >>> pull = VectorField(velocity=lambda q, p: p, force=lambda q, p: -4 * q)
        >>> start = PhaseState(torch.ones(1, 1), torch.zeros(1, 1))
        >>> round(float(leapfrog(pull, start, dt=0.01).p), 4)
        -0.04
    """

    velocity: Callable[[Tensor, Tensor], Tensor]
    force: Callable[[Tensor, Tensor], Tensor]
    separable: bool = True
    both: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]] | None = None

    @classmethod
    def joint(cls, both: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]) -> VectorField:
        """A field that is not separable, given as one function of both slopes."""
        return cls(lambda q, p: both(q, p)[0], lambda q, p: both(q, p)[1], False, both)


Advance = Callable[[VectorField, PhaseState, float, Memory], tuple[PhaseState, Memory]]


@dataclass(frozen=True)
class Integrator:
    """A one-step method: its name, its declared order and what it preserves.

    ``restarts``: whether a step without the last one's memory is the same step.

    Example:
        >>> spring = VectorField(velocity=lambda q, p: p, force=lambda q, p: -q)
        >>> one = torch.ones(1, 1, dtype=torch.float64)
        >>> for method in INTEGRATORS.values():
        ...     miss = float(method(spring, PhaseState(one, 0 * one), dt=0.1).q) - math.cos(0.1)
        ...     print(method.name, method.order, abs(miss) < 0.1**method.order)
        ...
        leapfrog 2 True
        leapfrog_compensated 2 True
        yoshida4 4 True
        kahan_li8 8 True
        rk4 4 True
        implicit_midpoint 2 True
        tao 2 True
    """

    name: str
    order: int
    symplectic: bool
    forces_per_step: int
    needs_separable: bool
    advance: Advance
    restarts: bool = True

    def __call__(self, field: VectorField, state: PhaseState, dt: float) -> PhaseState:
        """Advance ``state`` by ``dt`` seconds (negative runs time backwards)."""
        self.check(field)
        return self.advance(field, state, dt, None)[0]

    def check(self, field: VectorField) -> None:
        """Raise ``ValueError`` if the method is not defined for this field."""
        if self.needs_separable and not field.separable:
            raise ValueError(
                f"{self.name} needs a separable Hamiltonian T(p) + V(q); "
                "use implicit_midpoint or tao for this field"
            )


def _leapfrog(
    field: VectorField, state: PhaseState, dt: float, force: Memory
) -> tuple[PhaseState, Memory]:
    """Kick-drift-kick; the closing force is the next step's opening force."""
    if force is None:
        force = field.force(state.q, state.p)
    half = state.p + 0.5 * dt * force
    q = state.q + dt * field.velocity(state.q, half)
    force = field.force(q, half)
    return PhaseState(q, half + 0.5 * dt * force), force


_CUBE_ROOT = 2.0 ** (1.0 / 3.0)
YOSHIDA_WEIGHTS = (
    1 / (2 - _CUBE_ROOT),
    -_CUBE_ROOT / (2 - _CUBE_ROOT),
    1 / (2 - _CUBE_ROOT),
)
_KAHAN_LI_HALF = (
    0.13020248308889008,
    0.56116298177510838,
    -0.38947496264484729,
    0.15884190655515560,
    -0.39590389413323758,
    0.18453964097831571,
    0.25837438768632205,
    0.29501172360931030,
)
KAHAN_LI_WEIGHTS = (*_KAHAN_LI_HALF, 1 - 2 * sum(_KAHAN_LI_HALF), *_KAHAN_LI_HALF[::-1])


def _composed(weights: tuple[float, ...]) -> Advance:
    """Leapfrog steps whose lengths, the same from either end, cancel lower orders of the error."""

    def advance(
        field: VectorField, state: PhaseState, dt: float, force: Memory
    ) -> tuple[PhaseState, Memory]:
        for weight in weights:
            state, force = _leapfrog(field, state, weight * dt, force)
        return state, force

    return advance


def _compensated(
    field: VectorField, state: PhaseState, dt: float, memory: Memory
) -> tuple[PhaseState, Memory]:
    """Leapfrog whose sums carry along what rounding has cut off (Kahan)."""
    none = torch.zeros_like(state.q)
    force, lost_q, lost_p = memory or (field.force(state.q, state.p), none, none)
    half, lost_p = _plus(state.p, 0.5 * dt * force, lost_p)
    q, lost_q = _plus(state.q, dt * field.velocity(state.q, half), lost_q)
    force = field.force(q, half)
    p, lost_p = _plus(half, 0.5 * dt * force, lost_p)
    return PhaseState(q, p), (force, lost_q, lost_p)


def _plus(total: Tensor, change: Tensor, lost: Tensor) -> tuple[Tensor, Tensor]:
    """``total + change`` with what the last sum lost, and what this one loses."""
    change = change - lost
    after = total + change
    return after, (after - total) - change


def _slopes(field: VectorField, q: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
    """(dq/dt, dp/dt)."""
    if field.both is not None:
        return field.both(q, p)
    return field.velocity(q, p), field.force(q, p)


def _rk4(
    field: VectorField, state: PhaseState, dt: float, memory: Memory
) -> tuple[PhaseState, Memory]:
    q, p = state.q, state.p
    v1, f1 = _slopes(field, q, p)
    v2, f2 = _slopes(field, q + 0.5 * dt * v1, p + 0.5 * dt * f1)
    v3, f3 = _slopes(field, q + 0.5 * dt * v2, p + 0.5 * dt * f2)
    v4, f4 = _slopes(field, q + dt * v3, p + dt * f3)
    q = q + dt / 6 * (v1 + 2 * v2 + 2 * v3 + v4)
    p = p + dt / 6 * (f1 + 2 * f2 + 2 * f3 + f4)
    return PhaseState(q, p), memory


MIDPOINT_ITERATIONS = 100


def _implicit_midpoint(
    field: VectorField, state: PhaseState, dt: float, memory: Memory
) -> tuple[PhaseState, Memory]:
    """Solve x' = x + dt f((x + x') / 2) by fixed-point iteration to rounding.

    Raises:
        RuntimeError: the iteration does not contract (dt is too large for the field).
    """
    x = torch.stack([state.q, state.p])
    if x.numel() == 0:
        return state, memory
    tolerance, tiny = 8 * torch.finfo(x.dtype).eps, torch.finfo(x.dtype).tiny
    dx, previous = dt * torch.stack(_slopes(field, state.q, state.p)), math.inf
    for _ in range(MIDPOINT_ITERATIONS):
        q, p = x + 0.5 * dx
        new = dt * torch.stack(_slopes(field, q, p))
        # Relative to each episode's own size, for q and for p; amax hands a NaN on.
        size = (x.abs() + new.abs()).amax((-2, -1), keepdim=True).clamp_min(tiny)
        change = float(((new - dx).abs() / size).amax().detach())
        dx = new
        # At the rounding floor the change stops shrinking; that is convergence too.
        if change <= tolerance or (change >= previous and change <= 64 * tolerance):
            q, p = x + dx
            return PhaseState(q, p), memory
        previous = change
    raise RuntimeError(
        f"implicit_midpoint: the fixed-point iteration did not converge in "
        f"{MIDPOINT_ITERATIONS} rounds (last relative change {change:.1e}); use a smaller dt "
        f"than {dt:g} s"
    )


# Binds the two copies: at 20 the gate below holds as well, but on a fast double pendulum the copies
# drift apart within seconds even under the exact law.
TAO_OMEGA = 100.0


def _tao(
    field: VectorField, state: PhaseState, dt: float, shadow: Memory
) -> tuple[PhaseState, Memory]:
    """Tao's explicit second-order scheme for a Hamiltonian that need not be separable.

    The phase space is doubled to (q, p, x, y); H(q, y) and H(x, p) are each explicit, and a
    rotation of strength omega binds the two copies.
    """
    q, p = state.q, state.p
    x, y = (q, p) if shadow is None else (shadow.q, shadow.p)
    half = 0.5 * dt
    v, f = _slopes(field, q, y)  # H(q, y) moves x and p
    x, p = x + half * v, p + half * f
    v, f = _slopes(field, x, p)  # H(x, p) moves q and y
    q, y = q + half * v, y + half * f
    cos, sin = math.cos(2 * TAO_OMEGA * dt), math.sin(2 * TAO_OMEGA * dt)
    q_sum, q_diff, p_sum, p_diff = q + x, q - x, p + y, p - y
    turned_q, turned_p = cos * q_diff + sin * p_diff, cos * p_diff - sin * q_diff
    q, x = (q_sum + turned_q) / 2, (q_sum - turned_q) / 2
    p, y = (p_sum + turned_p) / 2, (p_sum - turned_p) / 2
    v, f = _slopes(field, x, p)
    q, y = q + half * v, y + half * f
    v, f = _slopes(field, q, y)
    x, p = x + half * v, p + half * f
    return PhaseState(q, p), PhaseState(x, y)


leapfrog = Integrator("leapfrog", 2, True, 1, True, _leapfrog)
leapfrog_compensated = Integrator("leapfrog_compensated", 2, True, 1, True, _compensated, False)
yoshida4 = Integrator("yoshida4", 4, True, 3, True, _composed(YOSHIDA_WEIGHTS))
kahan_li8 = Integrator("kahan_li8", 8, True, 17, True, _composed(KAHAN_LI_WEIGHTS))
rk4 = Integrator("rk4", 4, False, 4, False, _rk4)
implicit_midpoint = Integrator("implicit_midpoint", 2, True, 8, False, _implicit_midpoint)
tao = Integrator("tao", 2, True, 4, False, _tao, False)

INTEGRATORS = {
    m.name: m
    for m in (
        leapfrog,
        leapfrog_compensated,
        yoshida4,
        kahan_li8,
        rk4,
        implicit_midpoint,
        tao,
    )
}

TAO_GATE = 1e-4
TAO_GATE_STEPS = 2000


def tao_gate(dt: float) -> float:
    """Relative energy drift of :data:`tao` on a known non-separable Hamiltonian.

    The calibration gate of the study: H = (q^2 + 1)(p^2 + 1) / 2, whose energy
    must stay within ``TAO_GATE`` over ``TAO_GATE_STEPS`` steps of ``dt`` seconds.

    Returns:
        The largest relative drift seen.

    Raises:
        ValueError: the drift exceeds the gate, so tao may not be used at this ``dt``.

    Example:
        >>> tao_gate(dt=0.002) < TAO_GATE
        True
    """
    field = VectorField(
        velocity=lambda q, p: (q.square() + 1) * p,
        force=lambda q, p: -(p.square() + 1) * q,
        separable=False,
    )

    def energy(s: PhaseState) -> Tensor:
        return (s.q.square() + 1) * (s.p.square() + 1) / 2

    start = torch.tensor([[0.5]], dtype=torch.float64, device="cpu")
    state, shadow = PhaseState(start, torch.zeros_like(start)), None
    energies = [energy(state)]
    for _ in range(TAO_GATE_STEPS):
        state, shadow = _tao(field, state, dt, shadow)
        energies.append(energy(state))
    # Tensor.max hands a NaN on, so the comparison below refuses it.
    drift = float((torch.stack(energies) / energies[0] - 1).abs().max())
    if not drift <= TAO_GATE:
        raise ValueError(
            f"tao: calibration gate failed at dt = {dt:g} s: energy of a known Hamiltonian "
            f"drifts by {drift:.1e} > {TAO_GATE:g} in {TAO_GATE_STEPS} steps; use a smaller dt"
        )
    return drift
