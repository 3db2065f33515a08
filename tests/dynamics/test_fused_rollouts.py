"""Rollouts that run in fused loops by themselves, against the same steps one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from dynamics import HEADS, Parameters, PhaseState, build, rollout
from dynamics.compiled import cpu, pairs
from dynamics.domain import FARTHEST, NEAREST, extents
from dynamics.head import stepped
from loops.threads import held_to

DT = 0.002


def case(name, episodes=70, dtype=torch.float32):
    """A fresh head and bodies under it, more than one block of lanes."""
    head = build(HEADS[name], bodies=3, dt=DT).to(dtype)
    head.set_scale(1e-3, 1e-2)
    start = PhaseState(*torch.randn(2, episodes, 3, 2, dtype=dtype))
    mass = 1 + torch.rand(episodes, 3, dtype=dtype)
    return head, start, Parameters(torch.ones(episodes, dtype=dtype), mass)


@pytest.mark.parametrize("name", ["factored", "factored-radial", "unstructured"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_rollout_is_fused_and_gives_what_single_steps_give(name, dtype):
    head, start, params = case(name, dtype=dtype)
    with torch.no_grad():
        twin = stepped(head.advance, start, params, 30, DT, 3)
    found = rollout(head, start, params, 30, DT, every=3)
    assert found.backend == "numba"
    far = 100 * torch.finfo(dtype).eps
    assert (found.states.flat - twin.flat).abs().max() < far
    assert (twin.flat[:, -1] - twin.flat[:, 0]).abs().max() > 100 * far


@pytest.mark.parametrize("name", ["factored", "unstructured"])
def test_batch_axes_are_kept_and_parameters_broadcast(name):
    head, start, params = case(name, 24)
    wide = start.map(lambda x: x.reshape(4, 6, 3, 2))
    law = params[0]
    found = rollout(head, wide, law.map(lambda x: x.expand(4, 6, *x.shape)), 4, DT).states
    alone = rollout(head, wide[2], law.map(lambda x: x.expand(6, *x.shape)), 4, DT).states
    assert found.q.shape == (4, 6, 5, 3, 2)
    torch.testing.assert_close(found.q[2], alone.q, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["factored", "unstructured"])
def test_where_episodes_are_few_steps_are_single(name):
    head, start, params = case(name)
    assert rollout(head, start[:3], params[:3], 2, DT).backend == "torch"


def test_where_a_gradient_is_asked_loops_with_a_way_back_are_taken_or_single_steps():
    for name, backend in (
        ("factored", "numba"),
        ("factored-radial", "torch"),
        ("unstructured", "numba"),
    ):
        head, start, params = case(name)
        assert head.trajectory(start, params, 2, DT).backend == backend


def test_a_fused_map_refuses_another_step_as_well():
    head, start, params = case("unstructured")
    with pytest.raises(ValueError, match="trained for dt"):
        rollout(head, start, params, 2, 2 * DT)


@pytest.mark.parametrize("box", [None, 1.5])
def test_what_the_states_reached_is_looked_at_on_the_way(box):
    head = build(HEADS["factored"].throughout(box=box, width=16), bodies=3, dt=DT)
    start = PhaseState(*torch.randn(2, 150, 3, 2))
    start.q[77, 1] *= 40
    start.q[3, 0] = start.q[3, 1] + 1e-3
    with torch.no_grad():
        found = head.trajectory(start, Parameters(torch.ones(150), torch.ones(150, 3)), 12, DT, 4)
    *_, farthest, nearest = extents(found.states, box).flatten(0, 1).amax(0).tolist()
    assert found.reached == pytest.approx({FARTHEST: farthest, NEAREST: nearest}, 1e-4)


@pytest.mark.parametrize("far", [float("inf"), 3e38])
def test_a_state_that_is_not_finite_is_seen_on_the_way(far):
    head, start, params = case("factored")
    start.p[69, 2, 1] = far  # as the start is, so would the first stored state be
    with torch.no_grad():
        found = head.trajectory(start, params, 2, 1e3)
    assert not math.isfinite(sum(found.reached.values()))


@pytest.mark.parametrize("name", ["factored", "factored-radial"])
def test_what_lay_in_memory_before_does_not_matter(name):
    """A pair's work is not cleared; no number may come of it but through the network."""
    potential = case(name)[0].potential
    law = cpu.packed(potential, torch.empty(1))
    layers, units = law.weights.biases.shape
    room = [np.zeros(size, np.float32) for size in (8 * 64, 8 * 32, 0, 8 * 64)]
    room[2] = np.zeros((2 * layers, units * 64), np.float32)
    found = []
    for lain in (0.0, np.nan):
        work = np.full((1, pairs.ROWS, pairs.LANES), lain, np.float32)
        work[0, pairs.X], work[0, pairs.Y] = 0.3, np.linspace(-1, 1, pairs.LANES)
        work[0, pairs.S] = work[0, pairs.X] ** 2 + work[0, pairs.Y] ** 2 + 0.05**2
        far = np.float32(law.reach[0] ** 2)
        pairs.ask_networks(law, far, work, pairs.LANES, tuple(room))
        found.append(work[0, pairs.GX])
    assert np.isfinite(found[0]).all()
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize("name", ["factored", "factored-radial", "unstructured"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_how_episodes_are_shared_among_threads_does_not_matter(name, dtype):
    """Blocks that are full, half full and between give what one thread gives, in all bits."""
    head, start, params = case(name, dtype=dtype)
    found = []
    with torch.no_grad():
        for count in (1, 2, 3):
            with held_to(count):
                found.append(head.trajectory(start, params, 20, DT))
    assert all(torch.equal(x.states.flat, found[0].states.flat) for x in found)
    assert all(x.reached == found[0].reached for x in found)
