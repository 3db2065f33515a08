"""Whether a model of dynamics keeps its contract."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from dynamics import Head, Parameters, PhaseState, build
from dynamics.terms import HeadTerm, Term, from_config, to_config
from vidphys.testing.failed import (
    expect,
    expect_same,
    expect_slope,
    expect_spoiled,
    pickled,
    slope_of,
)
from vidphys.testing.states import alike, episodes, law

DT = 0.01  # seconds
SPAN = 0.4  # seconds, of the rollouts whose error falls with the step
OFF = 0.35  # by which a measured order may fall short of what is declared
ROUNDING = 1e-11  # error of a rollout in float64 below which no order shows


def check_head(
    model: HeadTerm | Head,
    bodies: int = 3,
    space: int = 2,
    params: Parameters | None = None,
    start: PhaseState | None = None,
    exchangeable: bool = False,
    impulsive: bool = False,
) -> None:
    """Check a model: everything that a rollout, a training and a study rely on.

    Shapes and dtypes of a step, the same answer twice and in any company, no finite answer to a
    NaN, gradients, and that it can be pickled. Where it has an energy, its force is the gradient;
    where it has a vector field, the error of a rollout falls with the step as the order of its
    integrator says.

    Args:
        model: a term, or a model built for so many ``bodies`` in ``space`` dimensions.
        bodies, space: of the states that it is asked about.
        params: that it is asked under, ``(4,)``; where not given, couplings and masses near one,
            and for a term, which is built for them, charges and the scalars of our own terms.
        start: states ``(4, n, d)`` in float64, where some mean nothing to the model.
        exchangeable: whether bodies of equal mass may change places.
        impulsive: whether something acts once a step, however short, so that no order shows.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    if params is None:
        params = law(bodies, plain=not isinstance(model, HeadTerm))
    if isinstance(model, HeadTerm):
        check_config(model)
        torch.manual_seed(0)
        model = build(model, bodies, DT, space, params.flat.shape[-1])
    expect(isinstance(model, Head), "a model", "a dynamics.Head", type(model).__name__)
    head, name = copy.deepcopy(model).double().eval(), type(model).__name__
    dt = DT if head.dt is None else head.dt
    start = episodes(bodies, space) if start is None else start
    random = _Step(head, name, dt).check(start, params, exchangeable)
    if hasattr(head, "energy"):
        _check_energy(head, name, start, params)
    if head.dt is None and not random and not impulsive:
        _check_order(head, name, start, params)


def check_config(term: Term) -> None:
    """Check that a term is what its configuration says, also after a way through JSON."""
    name = type(term).__name__
    held = from_config(json.loads(json.dumps(to_config(term))))
    expect(held == term, f"{name} after a way through JSON", term, held)
    expect(pickled(term, name) == term, f"{name}, pickled", term, "another")


class _Step:
    """One step of a model, from the same random numbers each time."""

    def __init__(self, head: Any, name: str, dt: float) -> None:
        self.head, self.name, self.dt = head, name, dt

    def __call__(self, state: PhaseState, params: Parameters) -> PhaseState:
        torch.manual_seed(0)
        return self.head.advance(state, params, self.dt)[0]

    def check(self, start: PhaseState, params: Parameters, exchangeable: bool) -> bool:
        """Whether it draws random numbers is returned: noise hides company, slope and order."""
        what = f"{self.name}.advance"
        with torch.no_grad():
            before, random = start.flat.clone(), torch.manual_seed(0).get_state()
            after = self(start, params)
            draws = not torch.equal(random, torch.get_rng_state())
            expect(torch.equal(before, start.flat), what, "its input left as it was", "changes")
            self._check_numbers(start, params, after, what, draws)
            again = self(start, params)
            expect(torch.equal(after.flat, again.flat), what, "the same answer twice", "another")
            handed = _Step(pickled(self.head, self.name), self.name, self.dt)(start, params)
            expect(torch.equal(after.flat, handed.flat), what, "the same when pickled", "another")
            if not draws:
                self._check_company(start, params, after, what)
            self._check_nan(start, params, what)
            if exchangeable:
                self._check_exchange(start, params, what)
        for part, index in (("positions", 0), ("momenta", 1)):
            self._check_slope(start, params, index, f"{what} in the {part}")
        return draws

    def _check_numbers(
        self, start: PhaseState, params: Parameters, after: PhaseState, what: str, draws: bool
    ) -> None:
        shape = tuple(start.q.shape)
        expect(tuple(after.q.shape) == shape, what, f"positions {shape}", tuple(after.q.shape))
        expect(bool(torch.isfinite(after.flat).all()), what, "finite numbers", "others")
        expect(after.flat.dtype == torch.float64, what, "float64 from float64", after.flat.dtype)
        coarse = _Step(copy.deepcopy(self.head).float(), self.name, self.dt)
        single = coarse(start.map(Tensor.float), params.map(Tensor.float)).flat
        expect(single.dtype == torch.float32, what, "float32 from float32", single.dtype)
        if not draws:
            expect_same(single.double(), after.flat, what, "float32 near float64", 1e-3)

    def _check_company(
        self, start: PhaseState, params: Parameters, after: PhaseState, what: str
    ) -> None:
        for index in (0, len(start.q) - 1, slice(1, 2)):
            alone = self(start[index], params[index]).flat
            expect_same(after[index].flat, alone, what, "an episode alone as in company")

    def _check_nan(self, start: PhaseState, params: Parameters, what: str) -> None:
        for part, index in (("position", 0), ("momentum", 1)):
            spoiled = (start.q, start.p)[index].clone()
            spoiled[0, 0, 0] = math.nan
            state = _replaced(start, index)(spoiled)
            expect_spoiled(partial(self._first, state, params), f"{what} of a NaN {part}")
            if index == 0 and self._feels(start, params):
                force = partial(self._force, state, params)
                expect_spoiled(force, f"{self.name}.force of a NaN {part}")

    def _force(self, state: PhaseState, params: Parameters) -> Tensor:
        return self.head.force(state, params)[0]

    def _feels(self, start: PhaseState, params: Parameters) -> bool:
        """Whether its force depends on where the bodies are."""
        elsewhere = PhaseState(1.1 * start.q, start.p)
        return not torch.equal(self._force(start, params), self._force(elsewhere, params))

    def _first(self, state: PhaseState, params: Parameters) -> Tensor:
        return self(state, params)[0].flat

    def _check_slope(self, start: PhaseState, params: Parameters, index: int, what: str) -> None:
        moved = _replaced(start, index)
        expect_slope(lambda x: self(moved(x), params).flat, (start.q, start.p)[index], what)

    def _check_exchange(self, start: PhaseState, params: Parameters, what: str) -> None:
        turn = list(range(1, start.q.shape[-2])) + [0]
        turned = self(start.map(lambda x: x[:, turn]), alike(params)).flat
        expected = self(start, alike(params)).map(lambda x: x[:, turn]).flat
        expect_same(expected, turned, what, "equal bodies to change places")


def _replaced(start: PhaseState, index: int) -> Callable[[Tensor], PhaseState]:
    return lambda x: PhaseState(*(x if k == index else y for k, y in enumerate((start.q, start.p))))


def _check_energy(head: Any, name: str, start: PhaseState, params: Parameters) -> None:
    energy = head.energy(start, params)
    shape = tuple(params.coupling.shape)
    expect(tuple(energy.shape) == shape, f"{name}.energy", f"shape {shape}", tuple(energy.shape))
    if getattr(getattr(head, "potential", None), "conservative", True):
        force = head.force(start, params).detach()
        gradient = slope_of(lambda q: head.energy(PhaseState(q, start.p), params), start.q)
        expect_same(-gradient, force, f"{name}.force", "minus the gradient of its energy")


def _check_order(head: Any, name: str, start: PhaseState, params: Parameters) -> None:
    order = getattr(getattr(head, "integrator", None), "order", 1)
    order = min(order, 2) if len(getattr(head, "ports", ())) else order

    def end(steps: int) -> Tensor:
        state, memory = start, None
        for _ in range(steps):
            state, memory = head.advance(state, params, SPAN / steps, memory)
        return state.flat

    with torch.no_grad():
        coarse, middle, fine = (end(steps) for steps in (8, 16, 32))
    first, second = (float((a - b).norm()) for a, b in ((coarse, middle), (middle, fine)))
    if second < ROUNDING * float(fine.norm()):
        return
    slope = math.log2(first / second)
    expect(
        slope >= order - OFF,
        f"{name}.advance",
        f"the error of a rollout to fall with the step to the power of {order}",
        f"{slope:.2f}",
    )
