"""Learned heads: near their training, their rounding; far outside, a warning, never silence."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import product

import torch

from dynamics import HEADS, Head, Parameters, PhaseState, build, rollout, terms
from dynamics.terms import HeadTerm
from vidphys.stress.bodies import STEP
from vidphys.stress.case import SOUND, WARNED, Case
from vidphys.stress.crowds import float_twin_error

FARTHER = (1.0, 10.0, 1e2, 1e3, 1e6, 1e12)  # times the states of training
BODIES, EPISODES, STEPS = 3, 4, 20
ROUNDING = 1e-4
FAMILIES: dict[str, HeadTerm] = {
    **{name: HEADS[name] for name in HEADS.ours()},
    "knots": terms.Hamiltonian(potentials=(terms.Knots(knots=6),)),
    "shortcut": terms.Hamiltonian(potentials=(terms.Shortcut((terms.Displacement(),)),)),
    "trapped": terms.Hamiltonian(potentials=(terms.Displacement(), terms.Trap(1.0))),
    "with friction": terms.Hamiltonian(ports=(terms.LinearFriction(),)),
    "triples": terms.Hamiltonian(potentials=(terms.Displacement(), terms.Triple())),
}


def heads() -> Iterator[Case]:
    """Each family of heads at its training's states and at ever larger ones, under both signs."""
    cell = partial(Case, "training range", integrator="own", path="rollout")
    for name in FAMILIES:
        for factor, coupling in product(FARTHER, (1.0, -1.0)):
            run, extreme = partial(_asked, name, factor, coupling), f"{factor:g} times"
            must = (WARNED,) if factor > 1 else (SOUND,)
            known = partial(cell, dtype="float32", must=must)
            yield known(name, f"{extreme}, G = {coupling:g}", factor, run, ROUNDING)
        for dtype in (torch.float16, torch.bfloat16):
            run = partial(_asked, name, 1.0, 1.0, dtype)
            short = str(dtype).removeprefix("torch.")
            yield cell(name, short, 1.0, run, 0.0, dtype=short, figure="A10")


def _asked(name: str, factor: float, coupling: float, dtype: torch.dtype = torch.float32) -> float:
    """Difference from the same weights in float64; infinite far from training: nothing is known."""
    head, start, params = trained(name)
    start = start.map(lambda x: (factor * x).to(dtype))
    law = params.with_coupling(coupling)
    if factor > 1:
        rollout(head, start, law, STEPS, STEP)
        return math.inf
    return float_twin_error(head, start, law, STEPS)


def trained(name: str, episodes: int = EPISODES) -> tuple[Head, PhaseState, Parameters]:
    """A head that has been told its training's states; its weights are as drawn."""
    torch.manual_seed(0)
    rng = torch.Generator().manual_seed(0)
    seen = PhaseState(*(torch.randn(episodes, BODIES, 2, generator=rng) for _ in range(2)))
    head = build(FAMILIES[name], BODIES, STEP)
    head.set_scale(1e-3, 1e-3)
    head.see(seen)
    return head, seen, Parameters(torch.ones(episodes), torch.ones(episodes, BODIES))
