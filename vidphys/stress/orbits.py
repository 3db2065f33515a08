"""Orbits: softening, mass ratio, coordinate scale, time step, and rollouts of a million steps."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product

import torch

from dynamics import INTEGRATORS, PhaseState, rollout
from vidphys.stress.bodies import DTYPES, STEP, Orbit, invariant_error
from vidphys.stress.case import SOUND, WARNED, Case

SHAPES = {"circle": 0.0, "ellipse": 0.9, "plunge": 1.0}
SOFTENINGS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
FAST = ("leapfrog", "leapfrog_compensated", "yoshida4", "rk4")
LOSS = 1e-2  # of energy, that is still called sound


def softening() -> Iterator[Case]:
    """A12: bound orbits at the study's step, each past its closest approach."""
    for eps in SOFTENINGS:
        for shape, eccentricity in SHAPES.items():
            orbit = Orbit(eccentricity, eps)
            for name in INTEGRATORS:
                dtypes = DTYPES if name in FAST else ("float64",)
                for dtype in dtypes:
                    yield _orbit("softening", f"{eps:g} {shape}", eps, orbit, name, dtype, 450)
            yield _orbit("softening", f"{eps:g} {shape}", eps, orbit, "leapfrog", "float64", 450, 3)
    for shape, eccentricity in SHAPES.items():
        name, orbit = "kahan_li8", Orbit(eccentricity, 1e-3)
        run, extreme = partial(_invariants, orbit, name, "float64", 450, STEP, 0), f"0.001 {shape}"
        kept = partial(Case, "softening", "two bodies", figure="A12", must=(SOUND,))
        yield kept(f"{extreme}, the option", 1e-3, run, 1e-6, name)


def _orbit(
    axis: str,
    extreme: str,
    value: float,
    orbit: Orbit,
    integrator: str,
    dtype: str,
    steps: int,
    episodes: int = 0,
    dt: float = STEP,
    bound: float = LOSS,
    figure: str = "A12",
) -> Case:
    run = partial(_invariants, orbit, integrator, dtype, steps, dt, episodes)
    path = "batched" if episodes else "eager"
    return Case(axis, "two bodies", extreme, value, run, bound, integrator, dtype, path, figure)


def _invariants(
    orbit: Orbit, integrator: str, dtype: str, steps: int, dt: float, episodes: int
) -> float:
    start, params = orbit.start(DTYPES[dtype], episodes)
    return invariant_error(orbit.law(integrator), start, params, steps, dt)


def mass_ratio() -> Iterator[Case]:
    """A13: a light body and one up to a million times as heavy."""
    shapes = {"circle": 0.0, "ellipse 0.5": 0.5}
    for power, shape in product(range(7), shapes):
        orbit, ratio = Orbit(shapes[shape], 0.1, (1.0, 10.0**-power)), 10.0**power
        told = "mass ratio", f"1e{power} {shape}", ratio, orbit
        for name, dtype in product(("leapfrog", "yoshida4", "rk4"), DTYPES):
            yield _orbit(*told, name, dtype, 400, 0, STEP, 1e-3, "A13")


def scale() -> Iterator[Case]:
    """A14: the same orbit in other units of length comes out the same."""
    cell = partial(Case, "scale", "two bodies", figure="A14")
    shapes = {"circle": 0.0, "ellipse": 0.5}
    for power, shape in product((-6, -4, -2, 2, 4, 6), shapes):
        size, extreme = 10.0**power, f"1e{power:+d} {shape}"
        for name in ("leapfrog", "kahan_li8", "rk4"):
            for dtype, bound in (("float64", 1e-12), ("float32", 1e-5)):
                run = partial(_scaled, shapes[shape], size, name, dtype)
                yield cell(extreme, size, run, bound, name, dtype)


def _scaled(eccentricity: float, size: float, integrator: str, dtype: str) -> float:
    """Largest difference from the same rollout at scale one, relative to its largest value."""
    flat = []
    for units in (1.0, size):
        orbit = Orbit(eccentricity, 0.1, scale=units)
        start, params = orbit.start(DTYPES[dtype])
        flat.append(rollout(orbit.law(integrator), start, params, 150, STEP).states.flat / units)
    return float((flat[1] - flat[0]).abs().max() / flat[0].abs().max())


def origin() -> Iterator[Case]:
    """The same orbit far from the origin, where positions are kept less finely."""
    for power in (1, 2, 3, 4, 6, 9, 12):
        for name in ("leapfrog", "leapfrog_compensated", "rk4"):
            for dtype in DTYPES:
                run = partial(_shifted, 10.0**power, name, dtype)
                size, extreme = 10.0**power, f"1e{power} away"
                yield Case("origin", "two bodies", extreme, size, run, LOSS, name, dtype)


def _shifted(away: float, integrator: str, dtype: str) -> float:
    """Largest difference from the same rollout at the origin, over the way of the bodies."""
    orbit = Orbit(0.5, 0.1)
    start, params = orbit.start(torch.float64)
    law, kind = orbit.law(integrator), DTYPES[dtype]
    exact = rollout(law, start, params, 150, STEP).states.q
    there = PhaseState(start.q + away, start.p).map(lambda x: x.to(kind))
    found = rollout(law, there, params.map(lambda x: x.to(kind)), 150, STEP).states.q.double()
    return float((found - away - exact).abs().max() / (exact - exact[0]).abs().max())


def time_step() -> Iterator[Case]:
    """A11: steps of 0.1 ms to 0.1 s, over four seconds or five hundred steps."""
    for dt in (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1):
        steps = min(500, round(4 / dt))
        for shape, eccentricity in {"circle": 0.0, "ellipse 0.5": 0.5}.items():
            orbit = Orbit(eccentricity, 0.1)
            for name in INTEGRATORS:
                dtypes = DTYPES if name in FAST else ("float64",)
                for dtype in dtypes:
                    extreme = f"{dt:g} s {shape}"
                    yield _orbit(
                        "time step", extreme, dt, orbit, name, dtype, steps, 0, dt, LOSS, "A11"
                    )
    cell = partial(Case, "time step", "two bodies", figure="A11", integrator="leapfrog")
    yield cell("error falls with the step", 1e-4, _not_monotone, 0.5, must=(SOUND,))
    yield cell("a fixed step above the limit is flagged", 0.1, _unflagged, 0.5, must=(WARNED,))


def _not_monotone() -> float:
    """How many times a shorter step had the larger error, of fixed steps over the same time."""
    orbit, errors = Orbit(0.5, 0.1), []
    start, params = orbit.start(torch.float64)
    for dt in (0.02, 0.01, 0.005, 0.0025):
        steps = round(2 / dt)
        error = invariant_error(
            orbit.law("leapfrog"), start, params, steps, dt, steps, substeps=False
        )
        errors.append(error)
    return float(sum(late > early for early, late in zip(errors, errors[1:], strict=False)))


def _unflagged() -> float:
    """The error of steps at omega dt = 4.5, which leapfrog cannot take."""
    orbit = Orbit(0.0, 0.1)
    start, params = orbit.start(torch.float64)
    near = start.map(lambda x: 0.05 * x)
    return invariant_error(orbit.law("leapfrog"), near, params, 50, 0.1, substeps=False)
