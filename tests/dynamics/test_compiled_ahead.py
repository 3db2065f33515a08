"""What workers train and roll through is compiled before they start."""

from __future__ import annotations

import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build
from dynamics.compiled import cpu, gradient, maps, unrolled, unrolled_orbits
from dynamics.compiled.ahead import compile_ahead
from vidphys.experiments.ladder import ALL_HEADS

LOOPS = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module, names in (
        (cpu, ("_roll",)),
        (maps, ("_roll",)),
        (gradient, ("gradient_rows", "backward_rows")),
        (unrolled, ("forward_rows", "backward_rows")),
        (unrolled_orbits, ("forward_blocks", "backward_blocks")),
    )
    for name in names
}


@pytest.fixture(scope="module")
def compiled():
    compile_ahead()
    return {name: list(loop.signatures) for name, loop in LOOPS.items()}


@pytest.mark.parametrize("name", ALL_HEADS)
def test_no_head_of_the_ladder_needs_another_loop(compiled, name):
    head = build(HEADS[name], 3, 0.01)
    start = PhaseState(*torch.randn(2, 100, 3, 2))
    params = Parameters(torch.ones(100), torch.ones(100, 3))
    head.trajectory(start, params, 4, 0.01, 2).states.flat.sum().backward()
    with torch.no_grad():
        head.trajectory(start, params, 4, 0.01, 2)
    assert {name: list(loop.signatures) for name, loop in LOOPS.items()} == compiled


def test_every_loop_is_compiled(compiled):
    assert all(compiled.values())
