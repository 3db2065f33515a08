"""Rollouts: integrator, step, substeps and precision, against a fine float64 reference."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch

from dynamics import INTEGRATORS, Hamiltonian, Head, Parameters, PhaseState, Rollout, rollout
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from dynamics.stability import rates_of, stiffest
from vidphys.metrics import energy_drift
from vidphys.scenes import Scene
from vidphys.scenes.gravity import SOFTENING
from vidphys.trade.context import DTYPES, Context
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "rollouts",
    "ms_per_second",
    1e3,
    "state_error",
    "float64 rollout by kahan_li8 at dt = 0.001 s; 90 % of the episodes have less |x - x'| / |x'|",
)
REFERENCE, FINE = "kahan_li8", 0.001  # seconds
STEPS = {  # seconds; costlier steps are taken less often
    "leapfrog": (0.01, 0.005, 0.002, 0.001),
    "yoshida4": (0.02, 0.01, 0.005, 0.002),
    "rk4": (0.02, 0.01, 0.005),
    "kahan_li8": (0.1, 0.05, 0.02),
    "implicit_midpoint": (0.02, 0.01),
    "tao": (0.002,),
}


def jobs(context: Context) -> Iterator[Job]:
    """The exact law by each integrator and step, then what precision and substeps change."""
    scene, sizes = context.scene, context.sizes
    start, params = scene.sample(sizes.episodes, context.rng("rollouts"))
    law = _law(REFERENCE)
    truth = rollout(law, start, params, round(sizes.seconds / FINE), FINE, substeps=False)
    rates = stiffest(rates_of(law, start, params), truth.states.q.movedim(1, 0)).rate
    fastest = float(rates.amax(0).quantile(0.9))
    case = _Case(scene, start, params, sizes.seconds, truth.at(-1), fastest)
    for name, steps in STEPS.items():
        for dt in steps:
            yield case.job(name, dt, "float64", substeps=False)
    for dt in (0.01, 0.002):
        yield case.job("leapfrog", dt, "float64", substeps=True)
    for name, dt in (("leapfrog", 0.002), ("leapfrog_compensated", 0.002), ("kahan_li8", 0.02)):
        yield case.job(name, dt, "float32", substeps=False)


@dataclass(frozen=True)
class _Case:
    """Episodes, how long they are rolled, where they end, and their fastest rate on the way.

    Of that, in radians per second, 90 % of the episodes have less, as of the error.
    """

    scene: Scene
    start: PhaseState
    params: Parameters
    seconds: float
    end: PhaseState
    fastest: float

    def job(self, integrator: str, dt: float, dtype: str, substeps: bool) -> Job:
        kind = DTYPES[dtype]
        start, params = self.start.map(lambda x: x.to(kind)), self.params.map(lambda x: x.to(kind))
        law, episodes = _law(integrator), len(self.start.q)
        steps, per_call = round(self.seconds / dt), episodes * self.seconds
        forces = INTEGRATORS[integrator].forces_per_step * steps * episodes
        return Job(
            task=f"gravity, {self.scene.bodies} bodies, {episodes} episodes together",
            configuration={
                **dict(integrator=integrator, dt=dt, substeps=substeps, dtype=dtype),
                "evaluation": "exact",
            },
            work=lambda: rollout(law, start, params, steps, dt, steps, substeps=substeps),
            errors=self.errors,
            per_call=per_call,
            dtype=dtype,
            units={"force_evaluations": forces / per_call, "radians": self.fastest * dt},
        )

    def errors(self, rolled: Rollout) -> dict[str, float]:
        """Error of the end state, and the drift of the true energy."""
        found = rolled.at(-1).map(torch.Tensor.double)
        away = (found.flat - self.end.flat).norm(dim=-1) / self.end.flat.norm(dim=-1)
        energy = self.scene.energy(rolled.states, self.params)
        drift = energy_drift(energy, self.scene.energy_scale(self.start, self.params))
        return {
            "state_error": float(away.quantile(0.9)),
            "state_error_p50": float(away.quantile(0.5)),
            "energy_drift_median": float(drift[:, -1].quantile(0.5)),
        }


def _law(integrator: str) -> Head:
    return Hamiltonian(FixedKinetic(), SoftenedGravity(SOFTENING), INTEGRATORS[integrator])
