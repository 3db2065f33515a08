"""Rollouts of a learned law: the network itself, its fused loop, and splines of it."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass

from dynamics import Head, Parameters, PhaseState, Rollout, rollout
from dynamics.compiled import compile_head
from vidphys.trade.context import DTYPES, Context
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "learned",
    "us_per_step",
    1e6,
    "deviation",
    "the same network in float64 at the same steps; 90 % of the episodes have less |x - x'| / |x'|",
)
TOLERANCES = (1e-3, 1e-5, 1e-6)  # of a spline's force


def jobs(context: Context) -> Iterator[Job]:
    """The trained head by each evaluation; a cost is of one step of one episode."""
    sizes, scene = context.sizes, context.scene
    start, params = scene.sample(sizes.episodes, context.rng("learned"))
    steps = round(sizes.seconds / scene.dt)
    exact = copy.deepcopy(context.head).double()
    truth = rollout(exact, start, params, steps, scene.dt, steps, substeps=False)
    case = _Case(start, params, steps, scene.dt, truth)
    yield case.job(exact, "network", None, "float64")
    yield case.job(context.head, "network", None, "float32")
    yield case.job(compile_head(context.head, None), "fused-network", None, "float32")
    for tolerance in TOLERANCES:
        spline = compile_head(context.head, tolerance)
        yield case.job(spline, "spline", tolerance, "float32")


@dataclass(frozen=True)
class _Case:
    start: PhaseState
    params: Parameters
    steps: int
    dt: float
    truth: Rollout

    def job(self, head: Head, evaluation: str, tolerance: float | None, dtype: str) -> Job:
        kind, episodes = DTYPES[dtype], len(self.start.q)
        start = self.start.map(lambda x: x.to(kind))
        params = self.params.map(lambda x: x.to(kind))

        def work() -> Rollout:
            return rollout(head, start, params, self.steps, self.dt, self.steps, substeps=False)

        return Job(
            task=f"factored-radial, {self.start.q.shape[-2]} bodies, {episodes} episodes",
            configuration={"evaluation": evaluation, "tolerance": tolerance, "dtype": dtype},
            work=work,
            errors=self.errors,
            per_call=episodes * self.steps,
            dtype=dtype,
            units={"force_evaluations": 1},
        )

    def errors(self, rolled: Rollout) -> dict[str, float]:
        found, truth = rolled.at(-1).flat.double(), self.truth.at(-1).flat
        away = (found - truth).norm(dim=-1) / truth.norm(dim=-1)
        return {"deviation": float(away.quantile(0.9)), "deviation_p50": float(away.quantile(0.5))}
