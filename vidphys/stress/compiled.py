"""Compiled pair laws on both backends, against the float64 network that they stand for."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, cast

import torch
from torch import Tensor

from dynamics import HEADS, Hamiltonian, PhaseState, build, rollout
from dynamics.compiled import CompiledHead, compile_head
from dynamics.compiled.head import Backend
from dynamics.potentials import PairPotential, SoftenedGravity
from vidphys.stress import questions
from vidphys.stress.bodies import DTYPES, STEP, Orbit
from vidphys.stress.case import ANY_HONEST, REFUSED, SOUND, WARNED, Case
from vidphys.stress.questions import SOFTENING, STEPS, Question

FAMILIES = ("factored", "factored-radial")
BACKENDS: tuple[Backend, ...] = ("torch", "numba")
FITS, PAIRS, RATE, WIDTH = 400, 256, 1e-2, 16  # steps and size of that fit
TOLERANCE = 1e-6  # of the splines' forces, in the floating type that they are used in
PATH = {"float64": 1e-4, "float32": 5e-3}  # bound of a path
SHAPES = {"circle": 0.0, "ellipse": 0.9, "plunge": 1.0}
FACTORS = (1e-6, 1e-4, 1e-2, 10.0, 1e2, 1e4, 1e6, 1e12)  # of the distances seen in training
SHIFTS = (1e2, 1e4, 1e6)  # world units of the whole scene from the origin
LONG = 100_000  # steps


@dataclass
class Learned:
    """A network that stands for softened gravity.

    Args:
        family: of the network.
    """

    family: str

    @cached_property
    def network(self) -> Hamiltonian:
        """Fitted when first asked for, in float64; it was shown two of the orbits."""
        with torch.random.fork_rng([]):
            torch.manual_seed(0)
            term = HEADS[self.family].throughout(width=WIDTH)
            head = cast(Hamiltonian, build(term, 2, STEP)).double()
            _fit(cast(PairPotential, head.potential))
        law = Orbit(0.0, SOFTENING).law("leapfrog")
        starts = [Orbit(e, SOFTENING).start(torch.float64) for e in (0, 0.9)]
        seen = [rollout(law, *start, STEPS, STEP).states for start in starts]
        head.see(PhaseState.stack(seen, 0))
        return head.requires_grad_(False)


@dataclass
class Fast:
    """One way to evaluate one compiled law.

    Args:
        law: the network.
        backend: that must run it, in fixed steps; with ``torch`` they are taken apart where needed.
        dtype: of the state and of the model.
    """

    law: Learned
    backend: Backend
    dtype: str

    @cached_property
    def head(self) -> CompiledHead:
        """The compiled model, made when first asked for: the splines take a while."""
        network = copy.deepcopy(self.law.network).to(DTYPES[self.dtype])
        return compile_head(network, TOLERANCE, backend=self.backend)

    def asked(self, question: Question) -> PhaseState:
        """The last state, ``(..., n, d)``, in float64.

        Raises:
            AssertionError: another backend has run it.
        """
        kind = DTYPES[self.dtype]
        start = question.start.map(lambda x: x.to(kind))
        params = question.params.map(lambda x: x.to(kind))
        substeps = self.backend == "torch"
        steps, dt = question.steps, question.dt
        run = rollout(self.head, start, params, steps, dt, steps, substeps=substeps)
        assert run.backend == self.backend or start.q.shape[-2] < 2, run.backend
        return run.at(-1).map(Tensor.double)

    def error(self, question: Callable[[], Question]) -> float:
        """Largest difference of the last state from the network's, over its largest change."""
        asked = question()
        found = self.asked(asked).flat
        if not found.numel():
            return 0.0
        exact = self.expected(asked).flat
        return float((found - exact).abs().max() / (exact - asked.start.flat).abs().max())

    def force_error(self) -> float:
        """Largest error of the momenta gained in a step from rest, over the largest one gained.

        The positions move by less than float32 can tell; they say nothing of the force.
        """
        asked = questions.at_rest()
        found, exact = self.asked(asked).p, self.expected(asked).p
        return float((found - exact).abs().max() / exact.abs().max())

    def expected(self, asked: Question) -> PhaseState:
        """The network's last state, in float64, with the same liberty of steps."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the reference's worries are not what is judged
            head, steps, substeps = self.law.network, asked.steps, self.backend == "torch"
            run = rollout(
                head, asked.start, asked.params, steps, asked.dt, steps, substeps=substeps
            )
        return run.at(-1)


def _fit(potential: PairPotential) -> None:
    """Teach a network the pair force, at distances spread evenly in their logarithm."""
    exact = SoftenedGravity(SOFTENING)
    optimiser = torch.optim.Adam(potential.parameters(), RATE)
    for _ in range(FITS):
        r = 10 ** (3 * torch.rand(PAIRS, 1, dtype=torch.float64) - 2.3)
        turn = 2 * math.pi * torch.rand(PAIRS, 1, dtype=torch.float64)
        apart = r * torch.cat([turn.cos(), turn.sin()], -1)
        wrong = potential.pair_gradient(apart) - exact.pair_gradient(apart)
        optimiser.zero_grad()
        wrong.square().mean().backward()
        optimiser.step()


def compiled() -> Iterator[Case]:
    """Each compiled law, on each backend, in each precision: where it was trained and far away."""
    for family in FAMILIES:
        law = Learned(family)
        for backend, dtype in product(BACKENDS, DTYPES):
            yield from cells(Fast(law, backend, dtype))


def cells(fast: Fast) -> Iterator[Case]:
    """One law on one backend in one precision."""
    case = partial(_case, fast)

    def asked(
        axis: str, extreme: str, value: float, question: Callable[[], Question], **told: Any
    ) -> Case:
        return case(axis, extreme, value, partial(fast.error, question), **told)

    sound = partial(case, "force", figure="A24", must=(SOUND,))
    yield sound("from rest", 1.0, fast.force_error, TOLERANCE)
    for (shape, eccentricity), coupling in product(SHAPES.items(), (1.0, -1.0, 100.0)):
        steps = round(STEPS / abs(coupling) ** 0.5)  # as far along the orbit
        question = partial(questions.orbit, eccentricity, coupling, steps=steps)
        extreme = f"{shape}, G = {coupling:g}"
        yield asked("orbit", extreme, 1 - eccentricity, question, figure="A12")
    for power in (2, 4, 6):
        question = partial(questions.orbit, 0.5, 1.0, mass=10.0**-power)
        yield asked("mass ratio", f"1e{power}", 10.0**power, question, figure="A13")
    for dt in (1e-4, 1e-2, 1e-1):
        question = partial(questions.orbit, 0.5, 1.0, dt=dt)
        yield asked("time step", f"{dt:g} s", dt, question, figure="A11")
    for factor in FACTORS:
        question = partial(questions.spread, factor)
        yield asked("distance", f"distances times {factor:g}", factor, question)
        yield _unknown(fast, factor)
    for shift in SHIFTS:
        yield asked("origin", f"{shift:g} away", shift, partial(questions.shifted, shift))
    for count in (0, 1, 3, 10):
        question = partial(questions.crowd, count)
        yield asked("bodies", f"N = {count}", count, question, figure="A15", must=(SOUND,))
    refused = partial(asked, "input", bound=0.0, figure="A30", must=(REFUSED,))
    for value, field in product((math.nan, math.inf), ("q", "p", "coupling", "mass")):
        yield refused(f"{field} is {value}", 1.0, partial(questions.spoiled, field, value))
    yield asked("coupling", "G = 1e30", 1e30, partial(questions.orbit, 0.5, 1e30, steps=2))
    if fast.backend == "numba":
        yield _long(fast)


def _case(
    fast: Fast,
    axis: str,
    extreme: str,
    value: float,
    run: Callable[[], float],
    bound: float | None = None,
    figure: str = "",
    must: tuple[str, ...] = ANY_HONEST,
) -> Case:
    bound = PATH[fast.dtype] if bound is None else bound
    told = bound, "leapfrog", fast.dtype, f"compiled, {fast.backend}", figure, must
    return Case(f"compiled: {axis}", fast.law.family, extreme, max(value, 0.5e-6), run, *told)


def _unknown(fast: Fast, factor: float) -> Case:
    """There is no right answer where nothing was learned: it must be said."""

    def run() -> float:
        fast.asked(questions.spread(factor))
        return math.inf

    extreme = f"{factor:g} times those of training"
    return _case(fast, "distance", extreme, factor, run, 0.0, must=(WARNED,))


def _long(fast: Fast) -> Case:
    """The compiled model's own energy, in fused steps."""

    def run() -> float:
        kind = DTYPES[fast.dtype]
        start, params = Orbit(0.05, SOFTENING).start(kind, 8)
        head = copy.deepcopy(fast.head)
        states = rollout(head, start, params, LONG, STEP, LONG // 100, substeps=False).states
        head, params = head.double(), params.map(lambda x: x.double().unsqueeze(1))
        energy = head.energy(states.map(Tensor.double), params)
        return float((energy / energy[:, :1] - 1).abs().max())

    return _case(fast, "long rollout", f"{LONG:,} steps, energy", float(LONG), run)
