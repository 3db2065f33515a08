"""Forces on N bodies: all pairs in either precision, pairs within a cut-off, and a tree."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import Parameters
from dynamics.contact import CutSpring
from dynamics.neighbours import WithinReach
from dynamics.potentials import Potential, SoftenedGravity
from dynamics.tree import BarnesHut
from vidphys.scenes.crowd import crowd
from vidphys.scenes.gravity import SOFTENING
from vidphys.trade.context import DTYPES, Context
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "forces",
    "ms_per_force",
    1e3,
    "force_error_p99",
    "float64 force of all pairs; 99 % of the bodies have less relative error",
)
TINY = 1e-300  # where no body feels a force
SMALL = 1e-3  # of the mean force: a smaller one is no unit for an error
GRAVITY_REACH = 4.0  # world units, about ten neighbours' distances
SPRING_REACH = 2.0  # world units: the springs break there, so that a cut-off changes nothing
ANGLES = (0.25, 0.5, 1.0)  # radians, at which far bodies are taken as one
FEW = 128  # bodies up to which neither neighbours nor groups are searched
COUNTS = (2, 8, 32, 128, 512, 1024, 2048, 4096, 8192, 16384)


def jobs(context: Context) -> Iterator[Job]:
    """Each N with each evaluation; a law of finite range needs no tree."""
    for bodies in COUNTS:
        if bodies > context.sizes.most_bodies:
            return
        start, params = crowd(bodies).sample(1, context.rng(f"forces-{bodies}"))
        gravity, springs = SoftenedGravity(SOFTENING), CutSpring(SPRING_REACH)
        for name, law, reach in (
            ("gravity", gravity, GRAVITY_REACH),
            ("breaking springs", springs, SPRING_REACH),
        ):
            with torch.no_grad():
                truth = law.force(start.q, params)
            task = f"{name}, {bodies} bodies"
            case = _Case(task, start.q, params, truth)
            for dtype in DTYPES:
                yield case.job(law, "pairs", dtype)
            if bodies < FEW:
                continue
            yield case.job(WithinReach(law, reach), "within-reach", "float64", reach=reach)
            for angle in ANGLES if law is gravity else ():
                yield case.job(BarnesHut(law, angle), "tree", "float64", angle=angle)


@dataclass(frozen=True)
class _Case:
    task: str
    q: Tensor
    params: Parameters
    truth: Tensor

    def job(
        self,
        law: Potential,
        evaluation: str,
        dtype: str,
        reach: float | None = None,
        angle: float | None = None,
    ) -> Job:
        bodies, kind = self.q.shape[-2], DTYPES[dtype]
        q, params = self.q.to(kind), self.params.map(lambda x: x.to(kind))

        def work() -> Tensor:
            with torch.no_grad():
                return law.force(q, params)

        return Job(
            task=self.task,
            configuration=dict(
                bodies=bodies, evaluation=evaluation, reach=reach, angle=angle, dtype=dtype
            ),
            work=work,
            errors=self.errors,
            per_call=1,
            dtype=dtype,
            units={"force_evaluations": 1, "pairs": bodies * (bodies - 1) / 2},
        )

    def errors(self, force: Tensor) -> dict[str, float]:
        """Relative to each body's own force, or to a small one where its own is smaller."""
        size = self.truth.norm(dim=-1)
        away = (force.double() - self.truth).norm(dim=-1) / size.clamp_min(
            max(SMALL * float(size.mean()), TINY)
        )
        return {
            "force_error_p99": float(away.quantile(0.99)),
            "force_error_p50": float(away.quantile(0.5)),
        }
