"""Walls: a ball that falls on a floor, and a swing that a wall cuts off, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial

import numpy as np
import torch

from dynamics import Hamiltonian, Parameters, PhaseState, rollout
from dynamics.fields import UniformField
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, Potential
from dynamics.walls import Wall, Walled
from vidphys.stress.bodies import DTYPES
from vidphys.stress.case import Case
from vidphys.stress.flights import Wall as Swing

PULL = 2.0  # world units per second squared; a fall from 1 takes a second
EXACT = {"float64": 1e-9, "float32": 2e-3}  # of the first height
SWING = Swing(0.3, 0.85, 16.0, -4.8, 0.0, -0.45, 0.0)
ORDER = 4.0  # world units over (omega dt)^2, the method's order, over ten bounces
SECONDS = 6.0


def walls() -> Iterator[Case]:
    """Steps from far below a bounce's flight to a tenth of it, every loss, floors far away."""
    for dtype in DTYPES:
        for dt in (1e-3, 1e-2, 0.03, 0.1):
            for restitution in (0.0, 0.3, 0.9, 1.0):
                run = partial(_dropped, dt, restitution, 0.0, dtype)
                extreme = f"dt {dt:g} restitution {restitution:g}"
                yield Case("wall", "ball", extreme, dt, run, EXACT[dtype], "leapfrog", dtype)
        for place in (1e2, 1e4, 1e6):
            run = partial(_dropped, 0.01, 0.9, place, dtype)
            extreme = f"floor at {place:g}"
            yield Case("wall", "ball", extreme, place, run, EXACT[dtype], "leapfrog", dtype)
        for dt in (2e-3, 1e-2, 0.03, 0.1):
            run = partial(_swung, dt, dtype)
            turn = SWING.stiffness**0.5 * dt
            bound = ORDER * turn**2
            yield Case("wall", "cut swing", f"omega dt {turn:g}", dt, run, bound, "leapfrog", dtype)


def _rolled(
    potential: Potential, wall: Wall, start: float, dt: float, dtype: str
) -> tuple[np.ndarray, np.ndarray]:
    """Times and places of a body that starts at rest, on a line."""
    head = Walled(Hamiltonian(FixedKinetic(), potential), wall)
    q = torch.full((1, 1, 1), start, dtype=DTYPES[dtype])
    one = torch.ones(1, dtype=DTYPES[dtype])
    params = Parameters(one, one.unsqueeze(-1))
    steps = round(SECONDS / dt)
    path = rollout(head, PhaseState(q, torch.zeros_like(q)), params, steps, dt)
    return dt * np.arange(steps + 1), path.states.q[0, :, 0, 0].double().numpy()


def _dropped(dt: float, restitution: float, place: float, dtype: str) -> float:
    field = UniformField(1).double()
    with torch.no_grad():
        field.acceleration.fill_(PULL)
    times, path = _rolled(field, Wall(place, restitution, (1.0,)), place - 1, dt, dtype)
    heights = np.array([height(float(t), restitution) for t in times])
    return float(np.abs(place - path - heights).max())


def height(t: float, restitution: float) -> float:
    """Above the floor of a ball that is dropped from 1, after ``t`` seconds, in closed form."""
    fall = math.sqrt(2 / PULL)
    if t < fall:
        return 1 - PULL * t**2 / 2
    t, speed = t - fall, restitution * PULL * fall
    while speed > 1e-6:
        if t < 2 * speed / PULL:
            return speed * t - PULL * t**2 / 2
        t, speed = t - 2 * speed / PULL, restitution * speed
    return 0.0


def _swung(dt: float, dtype: str) -> float:
    wall = Wall(SWING.place, SWING.restitution, (1.0,))
    times, path = _rolled(HarmonicTrap(SWING.stiffness), wall, SWING.start, dt, dtype)
    return float(np.abs(path - SWING.path(times)).max())
