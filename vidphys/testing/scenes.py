"""Whether a scene keeps its contract."""

from __future__ import annotations

import json
from collections.abc import Callable

import torch
from torch import Generator, Tensor

from dynamics import Parameters, PhaseState
from vidphys.scenes import SCENES, Scene, certify
from vidphys.testing.failed import SLOPE, STEP, expect, expect_same, pickled

EPISODES, STEPS, EVERY = 8, 200, 50
FIRST_STEP = 0.2  # of the largest way: what force and friction make of it within a step


def check_scene(scene: str | Callable[[], Scene]) -> None:
    """Check a scene: everything that `render`, the ladder and a training rely on.

    Episodes that come again with their seed, in float64; couplings above 0, because only one sign
    is trained on; a truth that starts where it was told to, keeps its energy and has its law's
    force and velocity; settings that can be written down.

    Args:
        scene: a registered name, a ``package.module:factory``, or a factory.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    factory = SCENES[scene] if isinstance(scene, str) else scene
    pickled(factory, "the scene's factory")
    made = factory()
    expect(isinstance(made, Scene), "a factory", "a vidphys.scenes.Scene", type(made).__name__)
    name = f"scene {made.name}"
    start, params = made.sample(EPISODES, Generator().manual_seed(1))
    again, _ = made.sample(EPISODES, Generator().manual_seed(1))
    expect(torch.equal(start.flat, again.flat), name, "the same episodes of a seed", "others")
    shape = (EPISODES, made.bodies, made.space)
    expect(tuple(start.q.shape) == shape, name, f"positions {shape}", tuple(start.q.shape))
    expect(start.q.dtype == torch.float64, name, "float64", start.q.dtype)
    wanted = shape[:2]
    expect(tuple(params.mass.shape) == wanted, name, f"masses {wanted}", tuple(params.mass.shape))
    expect(bool((params.mass > 0).all()), name, "masses above 0", params.mass.min().item())
    least = params.coupling.min().item()
    expect(least > 0, name, "couplings above 0: the other sign is what is asked about", least)
    expect(made.dt > 0, f"{name}: dt", "seconds above 0", made.dt)
    _check_truth(made, name, start)
    held = json.loads(json.dumps(made.settings))
    expect(isinstance(held, dict), f"{name}: settings", "plain data by name", held)


def _check_truth(made: Scene, name: str, start: PhaseState) -> None:
    _, params = made.sample(EPISODES, Generator().manual_seed(1))
    truth = made.simulate(start, params, STEPS, EVERY)
    stored = truth.states.q.shape[1]
    expect(stored == STEPS // EVERY + 1, f"{name}.simulate", STEPS // EVERY + 1, stored)
    expect(abs(truth.dt - EVERY * made.dt) < 1e-12, f"{name}: dt", EVERY * made.dt, truth.dt)
    expect_same(truth.states.q[:, 0], start.q, f"{name}.simulate", "the start it was given")
    share = float(certify(made, truth, conserving=made.conserves).passed.float().mean())
    expect(share >= 0.5, name, "most episodes certified", f"{share:.0%}")
    energy = made.law.energy(start, params)
    expect(tuple(energy.shape) == (EPISODES,), f"{name}: energy", (EPISODES,), energy.shape)
    force = made.law.force(start, params).detach()
    pushed = _pushed(made, start, params)
    expect_same(pushed, force, f"{name}: force", "minus the gradient of its energy", SLOPE)
    once = made.simulate(start, params, 1)
    slope = made.derivatives(start, params).q * made.dt
    moved = once.states.q[:, 1] - start.q
    expect_same(moved, slope, f"{name}: dq/dt", "the way of its first step", FIRST_STEP)


def _pushed(made: Scene, start: PhaseState, params: Parameters) -> Tensor:
    """Minus the gradient of the energy, by differences, ``(b, n, d)``."""
    slopes = []
    for unit in torch.eye(made.bodies * made.space, dtype=torch.float64):
        step = STEP * unit.reshape(made.bodies, made.space)
        ahead, behind = (
            made.law.energy(PhaseState(start.q + sign * step, start.p), params) for sign in (1, -1)
        )
        slopes.append((behind - ahead).detach() / (2 * STEP))
    return torch.stack(slopes, -1).reshape(start.q.shape)
