"""Problems that know their exact solution, float64, one time unit = one second."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from scipy.special import ellipj, ellipk
from torch import Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, VectorField
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity


@dataclass(frozen=True)
class Problem:
    """A Hamiltonian system, one of its orbits, and where that orbit is at any time."""

    name: str
    field: VectorField
    energy: Callable[[PhaseState], Tensor]
    exact: Callable[[float], PhaseState]
    period: float

    @property
    def start(self) -> PhaseState:
        return self.exact(0.0)


def state(q: list[float], p: list[float], space: int) -> PhaseState:
    """A float64 state of bodies whose coordinates are listed one body after the other."""
    flat = torch.tensor(q + p, dtype=torch.float64)
    return PhaseState.from_flat(flat, len(q) // space, space)


def _kepler() -> Problem:
    """An ellipse of eccentricity 0.3 around a fixed unit mass, from the pericentre."""
    e = 0.3

    def exact(t: float) -> PhaseState:
        anomaly = t
        for _ in range(50):  # Newton on Kepler's equation E - e sin E = t
            anomaly -= (anomaly - e * math.sin(anomaly) - t) / (1 - e * math.cos(anomaly))
        cos, sin, b = math.cos(anomaly), math.sin(anomaly), math.sqrt(1 - e * e)
        rate = 1 / (1 - e * cos)
        return state([cos - e, b * sin], [-sin * rate, b * cos * rate], space=2)

    field = VectorField(
        velocity=lambda q, p: p,
        force=lambda q, p: -q / q.square().sum(-1, keepdim=True) ** 1.5,
    )
    return Problem(
        "kepler",
        field,
        lambda s: (s.p.square().sum(-1) / 2 - s.q.square().sum(-1).rsqrt()).sum(-1),
        exact,
        2 * math.pi,
    )


def _pendulum() -> Problem:
    """H = p^2 / 2 - cos q, released at rest at 1.5 rad: sin(q / 2) = k sn(t + K, k^2)."""
    k = math.sin(1.5 / 2)
    quarter = float(ellipk(k * k))

    def exact(t: float) -> PhaseState:
        sn, cn, _, _ = ellipj(t + quarter, k * k)
        return state([2 * math.asin(k * sn)], [2 * k * cn], space=1)

    return Problem(
        "pendulum",
        VectorField(lambda q, p: p, lambda q, p: -q.sin()),
        lambda s: (s.p.square() / 2 - s.q.cos()).sum((-1, -2)),
        exact,
        4 * quarter,
    )


def _chain() -> Problem:
    """Three unequal masses on a line, joined to each other and to a wall by springs."""
    inverse_mass = torch.tensor([1.0, 0.5, 2.0], dtype=torch.float64).unsqueeze(-1)
    springs = torch.tensor([[3.0, -1, -0.5], [-1, 2, -0.7], [-0.5, -0.7, 2.5]], dtype=torch.float64)
    zero = torch.zeros_like(springs)
    generator = torch.cat(
        [torch.cat([zero, inverse_mass * torch.eye(3)], 1), torch.cat([-springs, zero], 1)]
    )
    start = torch.tensor([1.0, -0.3, 0.4, 0.2, 0.5, -0.1], dtype=torch.float64)

    def exact(t: float) -> PhaseState:
        return PhaseState.from_flat(torch.linalg.matrix_exp(generator * t) @ start, 3, 1)

    return Problem(
        "chain",
        VectorField(lambda q, p: inverse_mass * p, lambda q, p: -springs @ q),
        lambda s: ((inverse_mass * s.p.square() + s.q * (springs @ s.q)) / 2).sum((-1, -2)),
        exact,
        2 * math.pi / float(torch.linalg.eigvals(generator).imag.abs().min()),
    )


def _non_separable() -> Problem:
    """H = (q^2 + 1)(p^2 + 1) / 2 from rest at q = 1: q = cn(sqrt(2) t, 1/2), p = q' / (q^2 + 1)."""
    rate, m = math.sqrt(2), 0.5

    def exact(t: float) -> PhaseState:
        sn, cn, dn, _ = ellipj(rate * t, m)
        return state([cn], [-rate * sn * dn / (cn * cn + 1)], space=1)

    field = VectorField(
        velocity=lambda q, p: (q.square() + 1) * p,
        force=lambda q, p: -(p.square() + 1) * q,
        separable=False,
    )
    return Problem(
        "non-separable",
        field,
        lambda s: ((s.q.square() + 1) * (s.p.square() + 1) / 2).sum((-1, -2)),
        exact,
        4 * float(ellipk(m)) / rate,
    )


KEPLER, PENDULUM, CHAIN, NON_SEPARABLE = _kepler(), _pendulum(), _chain(), _non_separable()
PROBLEMS = (KEPLER, PENDULUM, CHAIN, NON_SEPARABLE)


def three_bodies(dtype: torch.dtype = torch.float64) -> tuple[Hamiltonian, PhaseState, Parameters]:
    """The study's softened three-body system (S1), a bound orbit with close passages."""
    start = state(
        [1.0, 0.1, -0.6, 0.8, -0.3, -0.9], [0.1, 0.5, -0.4, -0.3, 0.3, -0.2], space=2
    ).map(lambda x: x.to(dtype))
    params = Parameters(torch.tensor(1.0), torch.tensor([1.2, 0.8, 1.0]))
    return (
        Hamiltonian(FixedKinetic(), SoftenedGravity(0.1)),
        start,
        params.map(lambda x: x.to(dtype)),
    )
