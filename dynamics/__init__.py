"""Phase-space dynamics: states, integrators, energies, heads and rollouts. Knows no pixels."""

from dynamics import engines, terms
from dynamics.bath import ExactBath, relaxation_time, steady_temperature
from dynamics.build import build, parameter_count
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
from dynamics.friction import Friction
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
from dynamics.terms import HEADS, from_config, to_config

__all__ = [
    "DomainWarning",
    "DynamicsWarning",
    "EnergyWarning",
    "ExactBath",
    "FailureWarning",
    "Finding",
    "Friction",
    "HEADS",
    "INTEGRATORS",
    "Hamiltonian",
    "Head",
    "Integrator",
    "NoSteadyState",
    "OverlapWarning",
    "PairLaw",
    "Parameters",
    "PhaseState",
    "Rollout",
    "RoundingWarning",
    "StabilityWarning",
    "VectorField",
    "ballistic",
    "build",
    "engines",
    "from_config",
    "implicit_midpoint",
    "kahan_li8",
    "leapfrog",
    "leapfrog_compensated",
    "parameter_count",
    "relaxation_time",
    "rk4",
    "rollout",
    "steady_temperature",
    "tao",
    "tao_gate",
    "terms",
    "to_config",
    "yoshida4",
]
