"""Benchmark rows of accuracy: how far a compiled law strays, beside its network in float32."""

from __future__ import annotations

import copy
from functools import partial

import torch
from torch import Tensor

from benchmarks.contenders import DT, WIDTH, episodes, fitted
from benchmarks.match import BenchmarkRow
from dynamics import Hamiltonian, terms
from dynamics.compiled import compile_head

STEPS = 2000


def _deviation(name: str, plunge: bool) -> BenchmarkRow:
    """Compiled against float32 network: how far each strays from the float64 network."""
    found = strayed(fitted(terms.Displacement(width=WIDTH)), plunge, STEPS, DT)
    compiled, network = found["compiled"], found["network"]
    ratio = float(compiled.quantile(0.5) / network.quantile(0.5))
    low, high = (compiled / network).quantile(compiled.new_tensor([0.25, 0.75])).tolist()
    tail = float(compiled.quantile(0.9) / network.quantile(0.9))
    return BenchmarkRow(
        row=name,
        peer="float32 network",
        unit="largest |dq| from the float64 network",
        ours=float(compiled.quantile(0.5)),
        theirs=float(network.quantile(0.5)),
        ratio=ratio,
        low=low,
        high=high,
        bar=2.0,
        reached=ratio <= 2.0,
        path="numba",
        threads=1,
        clock="",
        repeats=1,
        numbers={
            "ratio at the 90th percentile": tail,
            "median nearest distance": float(found["nearest"].quantile(0.5)),
        },
    )


deviation_circular = partial(_deviation, "deviation, near-circular", plunge=False)
deviation_close = partial(_deviation, "deviation, close encounters", plunge=True)


def strayed(head: Hamiltonian, plunge: bool, steps: int, dt: float) -> dict[str, Tensor]:
    """Largest |dq| of each episode from the float64 network, of its float32 forms; and how close.

    Returns:
        ``network`` and ``compiled``, ``(episodes,)`` each, and ``nearest`` distances.
    """
    start, params = episodes(64, plunge)
    exact = compile_head(copy.deepcopy(head).double(), None)
    wide = start.map(Tensor.double), params.map(Tensor.double)
    truth = exact.trajectory(*wide, steps, dt).states.q
    found = {}
    with torch.no_grad():
        for name, model in (
            ("network", compile_head(head, None, backend="torch")),
            ("compiled", compile_head(head)),
        ):
            q = model.trajectory(start, params, steps, dt).states.q
            found[name] = (q - truth).norm(dim=-1).flatten(1).amax(-1)
    apart = truth - truth.roll(1, -2)
    return {**found, "nearest": apart.norm(dim=-1).flatten(1).amin(-1)}
