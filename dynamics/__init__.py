"""Phase-space dynamics: states, integrators, energies, heads and rollouts. Knows no pixels."""

from dynamics import engines
from dynamics.build import build
from dynamics.couplings import PairLaw
from dynamics.findings import (
    DomainWarning,
    DynamicsWarning,
    EnergyWarning,
    FailureWarning,
    Finding,
    NoSteadyState,
    OverlapWarning,
    RoundingWarning,
    StabilityWarning,
)
from dynamics.hamiltonian import Hamiltonian, ballistic
from dynamics.head import Head
from dynamics.integrators import (
    INTEGRATORS,
    Integrator,
    VectorField,
    implicit_midpoint,
    kahan_li8,
    leapfrog,
    leapfrog_compensated,
    rk4,
    tao,
    tao_gate,
    yoshida4,
)
from dynamics.rollout import Rollout, rollout
from dynamics.state import Parameters, PhaseState
from dynamics.terms import HEADS, HamiltonianTerms, ResidualTerms, Terms

__all__ = [
    "DomainWarning",
    "DynamicsWarning",
    "EnergyWarning",
    "FailureWarning",
    "Finding",
    "HEADS",
    "INTEGRATORS",
    "Hamiltonian",
    "HamiltonianTerms",
    "Head",
    "Integrator",
    "NoSteadyState",
    "OverlapWarning",
    "PairLaw",
    "Parameters",
    "PhaseState",
    "ResidualTerms",
    "Rollout",
    "RoundingWarning",
    "StabilityWarning",
    "Terms",
    "VectorField",
    "ballistic",
    "build",
    "engines",
    "implicit_midpoint",
    "kahan_li8",
    "leapfrog",
    "leapfrog_compensated",
    "rk4",
    "rollout",
    "tao",
    "tao_gate",
    "yoshida4",
]
