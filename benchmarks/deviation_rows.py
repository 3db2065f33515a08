"""Benchmark rows of accuracy: how far a compiled law strays, beside its network in float32."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.benchmark import BenchmarkRow
from benchmarks.contenders import BODIES_DT, WIDTH, deviations, fitted

STEPS = 2000


def _deviation(name: str, plunge: bool) -> BenchmarkRow:
    """Compiled against float32 network: how far each strays from the float64 network."""
    found = deviations(fitted("displacement", WIDTH), plunge, STEPS, BODIES_DT)
    compiled, network = found["compiled"], found["network"]
    ratio = float(compiled.median() / network.median())
    low, high = (compiled / network).quantile(compiled.new_tensor([0.25, 0.75])).tolist()
    tail = float(compiled.quantile(0.9) / network.quantile(0.9))
    return BenchmarkRow(
        row=name,
        peer="float32 network",
        unit="largest |dq| from the float64 network",
        ours=float(compiled.median()),
        theirs=float(network.median()),
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
            "median nearest distance": float(found["nearest"].median()),
        },
    )


def deviation_circular() -> BenchmarkRow:
    """Near-circular motion."""
    return _deviation("deviation, near-circular", plunge=False)


def deviation_close() -> BenchmarkRow:
    """Close encounters."""
    return _deviation("deviation, close encounters", plunge=True)


ROWS: dict[str, Callable[[], BenchmarkRow]] = {
    "deviation-circular": deviation_circular,
    "deviation-close": deviation_close,
}
