"""Numbers of bodies from none to ten thousand: forces against a direct sum, in bounded memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from typing import Any

import torch
from torch import Tensor

from dynamics import HEADS, Hamiltonian, Head, Parameters, PhaseState, ballistic, build, rollout
from dynamics.contact import SoftContact
from dynamics.events import HardDisks
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import PairPotential, SoftenedGravity
from vidphys.stress.bodies import DTYPES, STEP
from vidphys.stress.case import REFUSED, SOUND, Case

COUNTS = (0, 1, 2, 3, 10, 100, 1000, 10_000)
FIGURE = {"float64": 1e-6, "float32": 1e-5}  # the bar is 1e-6; of single precision, its rounding
CHECKED = 20  # bodies whose force is summed directly

LAWS: dict[str, Callable[[], PairPotential]] = {
    "gravity": lambda: SoftenedGravity(0.1),
    "soft contact": lambda: SoftContact(0.5),
}
LEARNED = ("factored", "factored-radial", "gns", "set-transformer", "unstructured", "symplectic")
MOST_LEARNED = 100  # more pairs of a network are a matter of minutes, not of soundness


def crowds() -> Iterator[Case]:
    """A15: exact laws up to ten thousand bodies, learned heads up to a hundred."""
    for count in COUNTS:
        cell = partial(_cell, count)
        for system, dtype in product(LAWS, DTYPES):
            if count == COUNTS[-1] and dtype == "float64":
                continue
            run = partial(_summed, system, count, dtype)
            yield cell(system, run=run, bound=FIGURE[dtype], dtype=dtype, path="forces")
            if count <= MOST_LEARNED:
                run = partial(_stepped, system, count, dtype)
                yield cell(system, run=run, bound=1e-3, dtype=dtype)
        learned = partial(cell, bound=1e-4, dtype="float32")
        for name in LEARNED if count <= MOST_LEARNED else ():
            must = (SOUND,) if count else (REFUSED,)
            yield learned(name, run=partial(_learned, name, count), must=must)
        if count <= 100:
            yield cell("no force", run=partial(_straight, count), bound=1e-12)
            yield cell("hard disks", run=partial(_disks, count), bound=1e-9)
    run = partial(_learned, "gns", COUNTS[-1])
    yield _cell(COUNTS[-1], "gns", run=run, bound=0.0, dtype="float32", must=(REFUSED,))


def _cell(count: int, system: str, path: str = "rollout", **told: Any) -> Case:
    told = {"must": (SOUND,), "figure": "A15", "path": path, **told}
    return Case("bodies", system, f"N = {count:,}", max(count, 0.5), **told)


def _crowd(count: int, dtype: str) -> tuple[PhaseState, Parameters]:
    """Bodies that fill a disk evenly, of total mass one, slow."""
    rng = torch.Generator().manual_seed(count)
    kind = DTYPES[dtype]
    q = max(1.0, count) ** 0.5 * torch.randn(count, 2, generator=rng, dtype=torch.float64)
    p = 0.1 / max(1, count) * torch.randn(count, 2, generator=rng, dtype=torch.float64)
    params = Parameters(torch.ones(()), torch.full((count,), 1.0 / max(1, count)))
    return PhaseState(q, p).map(lambda x: x.to(kind)), params.map(lambda x: x.to(kind))


def _summed(system: str, count: int, dtype: str) -> float:
    """Largest difference of some bodies' forces from the direct sum in float64."""
    state, params = _crowd(count, dtype)
    law = LAWS[system]()
    with torch.no_grad():
        force = law.force(state.q, params).double()
    if force.shape != state.q.shape:
        return float("inf")
    q, mass = state.q.double(), params.mass.double()
    chosen = torch.linspace(0, count - 1, min(count, CHECKED)).long()
    worst = 0.0
    size = float(force.norm(dim=-1).max()) if count > 1 else 1.0
    for body in chosen.tolist():
        pull = law.pair_gradient(q[body] - q) * (mass[body] * mass).unsqueeze(-1)
        pull[body] = 0
        worst = max(worst, float((force[body] + pull.sum(0)).abs().max()))
    return worst / max(size, 1e-30)


def _stepped(system: str, count: int, dtype: str) -> float:
    """Change of the total momentum of a short rollout over the sum of sizes, or not finite."""
    state, params = _crowd(count, dtype)
    run = rollout(Hamiltonian(FixedKinetic(), LAWS[system]()), state, params, 4, STEP, 4)
    return _momentum_change(run.states.p)


def _momentum_change(p: Tensor) -> float:
    if not p.numel():
        return 0.0
    total = p.double().sum(-2)
    return float((total[-1] - total[0]).abs().max() / p.double().norm(dim=-1).sum(-1).max())


def _learned(name: str, count: int) -> float:
    """Largest relative difference of a rollout from the same weights in float64."""
    torch.manual_seed(0)
    head: Head = build(HEADS[name], count, STEP)
    head.set_scale(1e-3, 1e-3)
    state, params = _crowd(count, "float32")
    return float_twin_error(head, state, params, 2)


def float_twin_error(head: Head, state: PhaseState, params: Parameters, steps: int) -> float:
    """Largest difference from the same weights in float64, over the largest value."""
    ours = rollout(head, state, params, steps, STEP, steps).at(-1).flat.double()
    twin = head.double()
    exact = rollout(
        twin, state.map(Tensor.double), params.map(Tensor.double), steps, STEP, steps
    ).at(-1)
    return float((ours - exact.flat).abs().max() / exact.flat.abs().max().clamp_min(1e-30))


def _straight(count: int) -> float:
    state, params = _crowd(count, "float64")
    end = rollout(ballistic(), state, params, 10, 0.1).at(-1)
    expected = state.q + state.p / params.mass.unsqueeze(-1)
    return float((end.q - expected).abs().sum())


def _disks(count: int) -> float:
    """Change of the kinetic energy of disks on a grid that fills a torus by a fifth."""
    side = max(1, round(count**0.5 + 0.499))
    grid = torch.cartesian_prod(torch.arange(side), torch.arange(side))[:count].double()
    rng = torch.Generator().manual_seed(0)
    p = torch.randn(count, 2, generator=rng, dtype=torch.float64)
    head = HardDisks(4.0, 0.5 * 4.0 / max(side, 2))
    params = Parameters(torch.ones(()).double(), torch.ones(count).double())
    run = rollout(head, PhaseState(grid * 4.0 / side, p), params, 5, 0.05)
    energy = run.states.p.square().sum((-2, -1))
    return float((energy / energy[0] - 1).abs().max()) if count else 0.0
