"""Phase-space dynamics: states, integrators, energies, heads and rollouts. Knows no pixels."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from registry import lazily

if TYPE_CHECKING:
    from dynamics import engines as engines
    from dynamics import terms as terms
    from dynamics.bath import ExactBath as ExactBath
    from dynamics.bath import relaxation_time as relaxation_time
    from dynamics.bath import steady_temperature as steady_temperature
    from dynamics.building import build as build
    from dynamics.building import parameter_count as parameter_count
    from dynamics.couplings import PairLaw as PairLaw
    from dynamics.findings import DomainWarning as DomainWarning
    from dynamics.findings import DynamicsWarning as DynamicsWarning
    from dynamics.findings import EnergyWarning as EnergyWarning
    from dynamics.findings import FailureWarning as FailureWarning
    from dynamics.findings import Finding as Finding
    from dynamics.findings import NoSteadyState as NoSteadyState
    from dynamics.findings import OverlapWarning as OverlapWarning
    from dynamics.findings import RoundingWarning as RoundingWarning
    from dynamics.findings import StabilityWarning as StabilityWarning
    from dynamics.friction import Friction as Friction
    from dynamics.hamiltonian import Hamiltonian as Hamiltonian
    from dynamics.hamiltonian import ballistic as ballistic
    from dynamics.head import Head as Head
    from dynamics.integrators import INTEGRATORS as INTEGRATORS
    from dynamics.integrators import Integrator as Integrator
    from dynamics.integrators import VectorField as VectorField
    from dynamics.integrators import implicit_midpoint as implicit_midpoint
    from dynamics.integrators import kahan_li8 as kahan_li8
    from dynamics.integrators import leapfrog as leapfrog
    from dynamics.integrators import leapfrog_compensated as leapfrog_compensated
    from dynamics.integrators import rk4 as rk4
    from dynamics.integrators import tao as tao
    from dynamics.integrators import tao_gate as tao_gate
    from dynamics.integrators import yoshida4 as yoshida4
    from dynamics.rolling import Rollout as Rollout
    from dynamics.rolling import rollout as rollout
    from dynamics.state import Parameters as Parameters
    from dynamics.state import PhaseState as PhaseState
    from dynamics.terms import HEADS as HEADS
    from dynamics.terms import from_config as from_config
    from dynamics.terms import to_config as to_config

HOMES = {
    "DomainWarning": "dynamics.findings",
    "DynamicsWarning": "dynamics.findings",
    "EnergyWarning": "dynamics.findings",
    "ExactBath": "dynamics.bath",
    "FailureWarning": "dynamics.findings",
    "Finding": "dynamics.findings",
    "Friction": "dynamics.friction",
    "HEADS": "dynamics.terms",
    "Hamiltonian": "dynamics.hamiltonian",
    "Head": "dynamics.head",
    "INTEGRATORS": "dynamics.integrators",
    "Integrator": "dynamics.integrators",
    "NoSteadyState": "dynamics.findings",
    "OverlapWarning": "dynamics.findings",
    "PairLaw": "dynamics.couplings",
    "Parameters": "dynamics.state",
    "PhaseState": "dynamics.state",
    "Rollout": "dynamics.rolling",
    "RoundingWarning": "dynamics.findings",
    "StabilityWarning": "dynamics.findings",
    "VectorField": "dynamics.integrators",
    "ballistic": "dynamics.hamiltonian",
    "build": "dynamics.building",
    "engines": "dynamics.engines",
    "from_config": "dynamics.terms",
    "implicit_midpoint": "dynamics.integrators",
    "kahan_li8": "dynamics.integrators",
    "leapfrog": "dynamics.integrators",
    "leapfrog_compensated": "dynamics.integrators",
    "parameter_count": "dynamics.building",
    "relaxation_time": "dynamics.bath",
    "rk4": "dynamics.integrators",
    "rollout": "dynamics.rolling",
    "steady_temperature": "dynamics.bath",
    "tao": "dynamics.integrators",
    "tao_gate": "dynamics.integrators",
    "terms": "dynamics.terms",
    "to_config": "dynamics.terms",
    "yoshida4": "dynamics.integrators",
}
TERMS = "dynamics.terms"  # models as data: no torch, which takes a second to load
__all__ = [*HOMES]
_get, __dir__ = lazily(__name__, HOMES)


def __getattr__(name: str) -> Any:
    """A name when it is first touched; what rolls a model comes with what makes it fast."""
    if HOMES.get(name, TERMS) != TERMS:
        importlib.import_module("dynamics.engines")
    return _get(name)
