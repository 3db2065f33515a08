"""A trained pair law as data: what the report's page rolls under its reader's hand."""

from __future__ import annotations

import base64
import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

    from dynamics import Hamiltonian, Head, Parameters, PhaseState

FILE = "play.json"
SCHEMA = 2  # 1 was not said and had no seal
CELL, TWIN = "oracle/factored", "oracle/unstructured"
CELLS = (
    32,
    64,
    96,
)  # along a side of a spline; the coarsest that is as good as the network is taken
WITHIN = 1e-5  # world units, over the whole rollout
STEPS, EVERY = 1000, 5
STARTS, APART = 64, 0.4  # of which one is taken whose bodies come no nearer (world units)
COUPLINGS = [round(0.1 * k, 1) for k in range(-15, 16)]  # at which the twin is rolled
DIGITS, TWIN_EVERY = 3, 25  # of the twin's places: decimals of world units, and steps between them


def write_play(run: Path) -> Path | None:
    """Write the oracle's law and its twin's answers into the run folder; nothing without them."""
    from vidphys.errors import InputError
    from vidphys.opened import open_run
    from vidphys.runs.sealed import write_sealed

    opened = open_run(run)
    seeds = opened.settings["seeds"]
    try:
        head = opened.head(CELL, seeds[0])
    except InputError:
        return None
    data = law_to_play(head)
    if data is None:
        return None
    try:
        twin = opened.head(TWIN, seeds[0])
    except InputError:
        twin = None
    if twin is not None:
        data["twin"] = _twin(twin, data)
    write_sealed(run / FILE, data, SCHEMA)
    return run / FILE


def law_to_play(head: Head) -> dict[str, Any] | None:
    """The pair law of a head as a spline, with a start of the scene of gravity to roll it from.

    Returns:
        ``None`` for a head whose law is no learned function of one displacement in a plane.
    """
    from dynamics import Hamiltonian
    from dynamics.compiled.spline import DEGREE, PlaneSpline, plane_coefficients, segment_basis
    from dynamics.potentials import CORE, REACH, DisplacementPotential
    from vidphys.scenes.gravity import SOFTENING, gravity

    if not isinstance(head, Hamiltonian) or not isinstance(head.potential, DisplacementPotential):
        return None
    exact = copy.deepcopy(head).double().requires_grad_(False)
    network = exact.potential
    assert isinstance(network, DisplacementPotential)
    scene = gravity()
    start, law = _calm(scene)
    flipped = law.with_coupling(-1.0)
    for cells in CELLS:
        rough = copy.deepcopy(exact)
        rough.potential = PlaneSpline(network, cells, reach=1e6).double()
        if max(_apart(rough, exact, start, x, scene.dt) for x in (law, flipped)) <= WITHIN:
            break
    half = plane_coefficients(network, cells).flatten()
    half = half[: -(-len(half) // 2)]
    return {
        "cell": CELL,
        "cells": cells,
        "basis": segment_basis(DEGREE).tolist(),
        "reach": REACH,
        "core": CORE,
        "softening": SOFTENING,
        "coefficients": base64.b64encode(half.numpy().astype("<f8").tobytes()).decode(),
        "dt": scene.dt,
        "steps": STEPS,
        "every": EVERY,
        "extent": round(2.6 * float(start.q.abs().max()), 2),
        "q": start.q[0].flatten().tolist(),
        "p": start.p[0].flatten().tolist(),
        "mass": law.mass[0].tolist(),
        "twin": None,
    }


def _calm(scene: Any) -> tuple[PhaseState, Parameters]:
    """Of several starts the most crowded one in which nobody meets, under either law.

    Through a close encounter no two models agree for long, and nothing would be seen but that.
    """
    import torch

    start, law = scene.sample(STARTS, torch.Generator().manual_seed(0))
    law = law.with_coupling(1.0)
    nearest = torch.full((STARTS,), torch.inf, dtype=torch.float64)
    for x in (law, law.with_coupling(-1.0)):
        q = scene.simulate(start, x, steps=STEPS).states.q
        gaps = torch.cdist(q, q) + 1e6 * torch.eye(q.shape[-2], dtype=q.dtype)
        nearest = torch.minimum(nearest, gaps.amin((1, 2, 3)))
    size = start.q.abs().amax((-2, -1)).where(nearest > min(APART, float(nearest.max()) / 2), 1e6)
    best = int(size.argmin())
    one = slice(best, best + 1)
    return start.map(lambda x: x[one]), law.map(lambda x: x[one])


def _apart(a: Hamiltonian, b: Hamiltonian, start: PhaseState, law: Parameters, dt: float) -> float:
    return float((_path(a, start, law, dt) - _path(b, start, law, dt)).abs().max())


def _path(head: Any, start: PhaseState, law: Parameters, dt: float) -> Tensor:
    import torch

    with torch.no_grad():
        return head.plain_trajectory(start, law, STEPS, dt, EVERY).states.q


def _twin(head: Head, data: dict[str, Any]) -> dict[str, Any]:
    """The twin's answers from the same start, at each of some couplings."""
    import torch

    from dynamics import Parameters, PhaseState, rollout

    count, bodies = len(COUPLINGS), len(data["mass"])
    q, p = (
        torch.tensor(data[name], dtype=torch.float32).reshape(1, bodies, 2).expand(count, -1, -1)
        for name in "qp"
    )
    mass = torch.tensor([data["mass"]], dtype=torch.float32).expand(count, -1)
    law = Parameters(torch.tensor(COUPLINGS, dtype=torch.float32), mass)
    with torch.no_grad():
        found = rollout(head, PhaseState(q, p), law, STEPS, data["dt"]).states.q
    places = found[:, ::TWIN_EVERY].flatten(-2).double().numpy()
    ends = np.isfinite(places).all((1, 2))
    return {
        "couplings": [g for g, ok in zip(COUPLINGS, ends, strict=True) if ok],
        "paths": np.round(places[ends], DIGITS).tolist(),
    }
