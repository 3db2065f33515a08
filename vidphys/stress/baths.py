"""Friction and heat: damping per step, temperature, and a drive up to and above the friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import partial
from itertools import product

import torch

from dynamics import Hamiltonian, Parameters, PhaseState, rollout
from dynamics.bath import ExactBath, relaxation_time
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.ports import Port
from dynamics.potentials import NoPotential
from vidphys.stress.bodies import DTYPES
from vidphys.stress.case import REFUSED, SOUND, WARNED, Case

DAMPINGS = (1e-3, 1e-2, 0.1, 1.0, 10.0, 100.0, 1e3)  # gamma dt
ROUNDING = {"float64": 1e-12, "float32": 1e-5}
MASS, SPEED, DT = 0.7, 1.3, 0.01


def friction() -> Iterator[Case]:
    """A17: ten steps of friction alone against the exact decay."""
    cell = partial(Case, "friction", path="port")
    kept = partial(cell, figure="A17", must=(SOUND,))
    refused = partial(cell, figure="A21", must=(REFUSED,))
    laws, strengths = ("linear", "square"), ("known", "guaranteed", "factored")
    for damping, law, strength, dtype in product(DAMPINGS, laws, strengths, DTYPES):
        run, system = partial(_decay, law, strength, damping, dtype), f"{law} friction, {strength}"
        extreme = f"gamma dt = {damping:g}"
        yield kept(system, extreme, damping, run, ROUNDING[dtype], dtype=dtype)
    for law, dtype in product(laws, DTYPES):
        run, system = partial(_decay, law, "guaranteed", -1.0, dtype), f"{law} friction, guaranteed"
        yield refused(system, "gamma < 0", -1.0, run, 0.0, dtype=dtype)


def _free(port: Port) -> Hamiltonian:
    return Hamiltonian(FixedKinetic(), NoPotential(), ports=[port])


def _decay(law: str, strength: str, damping: float, dtype: str) -> float:
    """Largest error of the speed over its start's, or 1 where it overshoots or grows."""
    kind = DTYPES[dtype]
    port = Friction(law, strength).to(kind)
    gamma = damping / DT * MASS
    params = Parameters(torch.ones((), dtype=kind), torch.full((1,), MASS, dtype=kind))
    params = params.with_scalar("friction", gamma)
    with torch.no_grad():
        real = float(port.coefficient(params))
    start = PhaseState(
        torch.zeros(1, 2, dtype=kind), torch.tensor([[MASS * SPEED, 0.0]], dtype=kind)
    )
    p = rollout(_free(port), start, params, 10, DT).states.p[:, 0, 0].double()
    time = DT * torch.arange(11).double()
    rate = real / MASS
    exact = torch.exp(-rate * time) if law == "linear" else 1 / (1 + rate * SPEED * time)
    if bool((p < 0).any() or (p.diff() > 0).any()):
        return 1.0
    return float((p / (MASS * SPEED) - exact).abs().max())


WALKERS, KICKS = 4000, 8
ERRORS = 3.0  # standard errors: the figure's bar


def temperature() -> Iterator[Case]:
    """A18 and A19: walkers that start in equilibrium stay there; no heat leaves friction alone."""
    cell = partial(Case, "temperature", "bath", path="port")
    dampings = (1e-3, 0.1, 1.0, 5.0)
    for heat, damping, dtype in product((1e-8, 1e-4, 1.0, 1e4, 1e6), dampings, DTYPES):
        run, extreme = partial(_equilibrium, heat, damping, dtype), f"gamma dt = {damping:g}"
        warm = partial(cell, dtype=dtype, figure="A18", must=(SOUND,))
        yield warm(f"T = {heat:g}, {extreme}", heat, run, ERRORS)
    for damping, dtype in product(dampings, DTYPES):
        run, extreme = partial(_cold, damping, dtype), f"T = 0, gamma dt = {damping:g}"
        cold = partial(cell, dtype=dtype, figure="A19", must=(SOUND,))
        yield cold(extreme, 1e-9, run, ROUNDING[dtype])
    for extreme, friction_, heat in (("T < 0", 1.0, -1.0), ("gamma < 0 < T", -1.0, 1.0)):
        run = partial(_rolled, friction_, heat)
        yield cell(extreme, heat, run, 0.0, figure="A21", must=(REFUSED,))


def _told(
    kind: torch.dtype, walkers: int, friction: float, heat: float, drive: float | None = None
) -> Parameters:
    params = Parameters(torch.ones(walkers, dtype=kind), torch.full((walkers, 1), MASS, dtype=kind))
    params = params.with_scalar("friction", friction).with_scalar("temperature", heat)
    return params if drive is None else params.with_scalar("drive", drive)


def _equilibrium(heat: float, damping: float, dtype: str) -> float:
    """|T / T_0 - 1| in standard errors, after some steps."""
    kind = DTYPES[dtype]
    rng = torch.Generator().manual_seed(1)
    p = (MASS * heat) ** 0.5 * torch.randn(WALKERS, 1, 2, generator=rng, dtype=torch.float64)
    start = PhaseState(torch.zeros_like(p), p).map(lambda x: x.to(kind))
    params = _told(kind, WALKERS, damping / DT, heat)
    end = rollout(_free(ExactBath()), start, params, KICKS, DT, KICKS, seed=2).at(-1).p.double()
    ratio = float((end.square() / MASS / heat).mean())
    return abs(ratio - 1) / math.sqrt(2 / end.numel())


def _cold(damping: float, dtype: str) -> float:
    """Relative error of the decay without noise."""
    kind = DTYPES[dtype]
    p = torch.tensor([[[1.0, -2.0]]], dtype=kind)
    params = _told(kind, 1, damping / DT, 0.0)
    run = rollout(_free(ExactBath()), PhaseState(torch.zeros_like(p), p), params, 5, DT, seed=0)
    exact = p[0, 0] * math.exp(-5 * damping)
    return float(((run.at(-1).p - exact) / exact).abs().max())


def _rolled(friction_: float, heat: float) -> float:
    p = torch.ones(1, 1, 2, dtype=torch.float64)
    params = _told(torch.float64, 1, friction_, heat)
    rollout(_free(ExactBath()), PhaseState(p, p), params, 1, DT)
    return math.inf


GAMMA = 2.0


def drive() -> Iterator[Case]:
    """A20: the temperature under a drive that comes near the friction, reaches it, exceeds it."""
    cell = partial(Case, "drive", "driven bath", path="port", figure="A20")
    for strength, dtype in product((0.0, 1.0, 1.5, 1.9, 1.99, 1.999, 2.0, 2.5), DTYPES):
        run, extreme = partial(_driven, strength, dtype), f"A = {strength:g}, gamma = 2"
        must = (SOUND,) if strength < GAMMA else (WARNED,)
        yield cell(extreme, max(strength, 1e-3), run, 0.05, dtype=dtype, must=must)


def _driven(strength: float, dtype: str) -> float:
    """|T / T_steady - 1| after twenty relaxation times from half the temperature."""
    kind = DTYPES[dtype]
    params = _told(kind, WALKERS, GAMMA, 1.0, strength)
    time = float(relaxation_time(params)[0])
    rng = torch.Generator().manual_seed(3)
    p = (0.5 * MASS) ** 0.5 * torch.randn(WALKERS, 1, 2, generator=rng, dtype=torch.float64)
    start = PhaseState(torch.zeros_like(p), p).map(lambda x: x.to(kind))
    dt = 0.2 * time if math.isfinite(time) else 1.0
    end = rollout(_free(ExactBath()), start, params, 100, dt, 100, seed=4).at(-1).p.double()
    if not math.isfinite(time):
        return math.inf
    expected = GAMMA / (GAMMA - strength)
    return abs(float((end.square() / MASS).mean()) / expected - 1)
