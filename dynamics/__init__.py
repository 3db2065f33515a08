"""Phase-space dynamics: states, integrators, energies, heads and rollouts. Knows no pixels."""

from dynamics.build import build
from dynamics.couplings import PairLaw
from dynamics.hamiltonian import Hamiltonian, ballistic
from dynamics.head import Head
from dynamics.integrators import (
    INTEGRATORS,
    Integrator,
    VectorField,
    implicit_midpoint,
    leapfrog,
    rk4,
    tao,
    tao_gate,
    yoshida4,
)
from dynamics.rollout import Rollout, rollout
from dynamics.state import Parameters, PhaseState
from dynamics.terms import HEADS, HamiltonianTerms, ResidualTerms, Terms

__all__ = [
    "HEADS",
    "INTEGRATORS",
    "Hamiltonian",
    "HamiltonianTerms",
    "Head",
    "Integrator",
    "PairLaw",
    "Parameters",
    "PhaseState",
    "ResidualTerms",
    "Rollout",
    "Terms",
    "VectorField",
    "ballistic",
    "build",
    "implicit_midpoint",
    "leapfrog",
    "rk4",
    "rollout",
    "tao",
    "tao_gate",
    "yoshida4",
]
