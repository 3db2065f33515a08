"""What is asked of any head: to go on from a start as the truth does, under whatever law."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, Rollout, rollout
from dynamics.compiled import form_of
from vidphys.placement import CPU, moved, suited
from vidphys.scenes import Scene, lyapunov_time

T = TypeVar("T")
INVERSION_STEPS = 150


@dataclass(frozen=True)
class Question:
    """What is asked of a head.

    Args:
        scene: gives the truth.
        start: where the head starts, possibly perceived, ``(b, n, d)``.
        truth: the true state at the same moment; both references start here.
        params: the law that held until then (G > 0).
        steps: reference steps of an inversion.
        every: reference steps between compared states; a pixel head's own step.
        known: what the truth has answered; shared by questions that are made from this one.
    """

    scene: Scene
    start: PhaseState
    truth: PhaseState
    params: Parameters
    steps: int = INVERSION_STEPS
    every: int = 5
    known: dict[tuple[Hashable, ...], tuple[Scene, Any]] = field(
        default_factory=dict, repr=False, compare=False
    )

    @property
    def lyapunov_time(self) -> Tensor:
        """Seconds in which a small error of each true start grows by e, ``(b,)``."""
        key = "lyapunov", *self._asked(self.params)
        return self._once(key, lambda: lyapunov_time(self.scene, self.truth, self.params))

    def starting(self, start: PhaseState) -> Question:
        """The same question from another start; what the truth answers is shared."""
        return replace(self, start=start)

    def alone(self, episode: int, steps: int) -> Question:
        """One of the episodes, for so many steps; what the truth answers is shared."""
        one = slice(episode, episode + 1)
        start, truth, params = self.start[one], self.truth[one], self.params[one]
        return replace(self, start=start, truth=truth, params=params, steps=steps)

    def step_of(self, head: Head) -> float:
        """Seconds of a head's own step, or else of the reference's."""
        return self.scene.dt if head.dt is None else head.dt

    def ask(
        self, head: Head, steps: int, params: Parameters | None = None, substeps: bool = True
    ) -> Rollout:
        """The head's rollout over ``steps`` reference steps, in its own step and precision.

        A long one of a learned pair law is its spline's: see :mod:`dynamics.compiled.choice`.
        """
        start, law = suited((self.start, self.params if params is None else params), head)
        dt = self.step_of(head)
        every = round(self.every * self.scene.dt / dt)
        count = steps // self.every * every
        head = form_of(head, start, law, count, dt, substeps).head
        return moved(rollout(head, start, law, count, dt, every, substeps=substeps), CPU)

    def reference(self, params: Parameters, steps: int | None = None) -> Rollout:
        """The truth under a law, from the true start; rolled once for each law and length."""
        steps = self.steps if steps is None else steps
        key = "reference", *self._asked(params), steps, self.every
        simulate = self.scene.simulate
        return self._once(key, lambda: simulate(self.truth, params, steps, self.every))

    def _asked(self, params: Parameters) -> tuple[Hashable, ...]:
        numbers = torch.cat([self.truth.flat.flatten(), params.flat.flatten()])
        return id(self.scene), numbers.numpy().tobytes()

    def _once(self, key: tuple[Hashable, ...], make: Callable[[], T]) -> T:
        if key not in self.known:
            self.known[key] = self.scene, make()  # the scene, so that no other has its id
        return self.known[key][1]

    def straight_lines(self) -> Rollout:
        """The zero-force predictor from the *true* start, the stricter yardstick."""
        truth = self.truth.map(Tensor.double)
        params = self.params.map(Tensor.double)
        return self.scene.straight_lines(truth, params, self.steps, self.every)
