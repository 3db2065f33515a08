"""Contacts: stiffness, bodies at one place, and gradients at first touch."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import torch
from torch import Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, rollout
from dynamics.contact import (
    CutSpring,
    FreeImpulse,
    ImpulsePort,
    KnotPotential,
    Restitution,
    SoftContact,
)
from dynamics.events import HardDisks
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import (
    DisplacementPotential,
    NoPotential,
    PairPotential,
    RadialPotential,
    SoftenedGravity,
)
from vidphys.stress.bodies import DTYPES, STEP, colliding, contact_law, invariant_error
from vidphys.stress.case import SOUND, WARNED, Case

DIAMETER = 0.5
LOSS = 0.05  # of energy: the figure's bar
STEPS = 300


def stiffness() -> Iterator[Case]:
    """A16: from a soft push to one whose period is a fourteenth of a step."""
    hard = (30.0, 3e2, 3e3, 3e4, 3e5, 1e6, 1e7, 1e8)
    cell = partial(Case, "contact stiffness", "two disks", figure="A16")
    for k, (offset, way) in product(hard, ((0.0, "head on"), (0.2, "glancing"))):
        for name, dtype, substeps in product(
            ("leapfrog", "yoshida4", "rk4"), DTYPES, (True, False)
        ):
            run = partial(_collision, k, offset, name, dtype, substeps)
            path = "pieces" if substeps else "fixed steps"
            yield cell(f"{k:g} {way}", k, run, LOSS, name, dtype, path)


def _collision(k: float, offset: float, integrator: str, dtype: str, substeps: bool) -> float:
    start, params = colliding(DTYPES[dtype], k, offset)
    law = contact_law(DIAMETER, integrator)
    return invariant_error(law, start, params, STEPS, STEP, substeps=substeps)


PAIRS: dict[str, Callable[[], PairPotential]] = {
    **{f"gravity {eps:g}": partial(SoftenedGravity, eps) for eps in (1e-1, 1e-3, 1e-6)},
    "soft contact": lambda: SoftContact(DIAMETER),
    "cut spring": lambda: CutSpring(DIAMETER),
    "knots": lambda: KnotPotential(6, DIAMETER),
    "displacement network": lambda: DisplacementPotential(2, 16, "tanh"),
    "radial network": lambda: RadialPotential(16, "tanh"),
}


def coincidence() -> Iterator[Case]:
    """A27: forces, energies and gradients where two bodies are at one place, or just touch."""
    cell = partial(Case, "coincidence", figure="A27")
    places = {"one place": 0.0, "first touch": DIAMETER}
    ways = {"forces": _unbounded, "gradients": _bent}
    for (system, make), place, dtype, path in product(PAIRS.items(), places, DTYPES, ways):
        run = partial(ways[path], make, places[place], dtype)
        known = partial(cell, dtype=dtype, path=path, must=(SOUND,))
        yield known(system, place, places[place], run, 0.0)
    for (name, port), dtype in product(
        (("restitution", Restitution), ("free impulse", FreeImpulse)), DTYPES
    ):
        yield cell(name, "one place", 0.0, partial(_kicked, port, dtype), 0.0, dtype=dtype)
    for dtype in DTYPES:
        run = partial(_overlapping, dtype)
        yield cell("hard disks", "one place", 0.0, run, 0.0, dtype=dtype, must=(WARNED,))


def _place(apart: float, dtype: str) -> tuple[Tensor, Parameters]:
    kind = DTYPES[dtype]
    q = torch.tensor([[0.1, 0.2], [0.1 + apart, 0.2]], dtype=kind, requires_grad=True)
    return q, Parameters(torch.ones((), dtype=kind), torch.ones(2, dtype=kind))


def _unbounded(make: Callable[[], PairPotential], apart: float, dtype: str) -> float:
    """How many numbers of force and energy are not finite, and whether third's law fails."""
    torch.manual_seed(0)
    q, params = _place(apart, dtype)
    law = make().to(DTYPES[dtype])
    force = law.force(q, params)
    found = torch.cat([force.flatten(), law.energy(q, params).reshape(1)])
    return float((~torch.isfinite(found)).sum() + (force.sum(0) != 0).sum())


def _bent(make: Callable[[], PairPotential], apart: float, dtype: str) -> float:
    """How many numbers are not finite in the gradient of the energy, and in that of the force."""
    torch.manual_seed(0)
    q, params = _place(apart, dtype)
    law = make().to(DTYPES[dtype])
    (first,) = torch.autograd.grad(law.energy(q, params), q)
    (second,) = torch.autograd.grad(law.force(q, params).square().sum(), q)
    return float(sum((~torch.isfinite(x)).sum() for x in (first, second)))


def _kicked(port: Callable[[float | None], ImpulsePort], dtype: str) -> float:
    torch.manual_seed(0)
    q, params = _place(0.0, dtype)
    head = Hamiltonian(FixedKinetic(), NoPotential(), ports=[port(None)]).to(DTYPES[dtype])
    p = torch.tensor([[1.0, 0.0], [-1.0, 0.5]], dtype=DTYPES[dtype])
    run = rollout(head, PhaseState(q.detach(), p), params, 10, STEP)
    total = run.states.p.sum(-2)
    return float((~torch.isfinite(run.states.flat)).sum()) + float(
        ((total - total[0]).abs() > 1e-5).sum()
    )


def _overlapping(dtype: str) -> float:
    q, params = _place(0.0, dtype)
    head = HardDisks(4.0, DIAMETER)
    rollout(head, PhaseState(q.detach(), torch.zeros_like(q.detach())), params, 5, STEP)
    return float("inf")  # what hard disks do inside each other is not defined
