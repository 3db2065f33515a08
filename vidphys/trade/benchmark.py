"""Our fast paths beside their peers: the same work, interleaved, as ratios of medians."""

from __future__ import annotations

import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

BODIES_DT = 0.002  # seconds
WIDTH = 256  # of the networks in rollouts
LONG, USUAL, SHORT, FEW = 2000, 150, 40, 8  # steps of fast, of slow and of the slowest contenders
EPISODES, MANY_EPISODES = 64, 1024
SETTLE = 0.03  # seconds between calls


@dataclass(frozen=True)
class Contender:
    """Something that is timed.

    Args:
        work: one call.
        amount: units of work in a call.
        path: what runs it, e.g. ``numba``.
    """

    work: Callable[[], Any]
    amount: float
    path: str


@dataclass(frozen=True)
class Match:
    """Ours against peers, by name, with the least ratio of speed that is asked for."""

    row: str
    unit: str
    ours: Contender
    peers: dict[str, tuple[Contender, float]]


@dataclass(frozen=True)
class BenchmarkRow:
    """Ours against one peer.

    Args:
        row, peer: names.
        unit: of the work.
        ours, theirs: units a second, medians.
        ratio: ours to theirs; ``low`` and ``high`` are quartiles over the rounds.
        bar: least ratio that is asked for (largest, for a deviation).
        reached: whether it is met.
        path: what ran ours.
        threads: of each contender.
        clock: ``cpu`` seconds of the process for one thread, else ``wall``.
        repeats: rounds.
        numbers: whatever else was measured.
    """

    row: str
    peer: str
    unit: str
    ours: float
    theirs: float
    ratio: float
    low: float
    high: float
    bar: float
    reached: bool
    path: str
    threads: int
    clock: str
    repeats: int
    numbers: dict[str, float] = field(default_factory=dict)


def run_benchmark(rows: Sequence[str], repeats: int, threads: int) -> list[BenchmarkRow]:
    """Measure rows, each in a fresh process that is held to ``threads`` cores.

    Args:
        rows: of :data:`ROWS`.
        repeats: interleaved rounds, at least 3.
        threads: 1 for one core.

    Raises:
        ValueError: an unknown row, or fewer than 3 repeats.
        ImportError: a peer is not installed (the extra ``bench``).
    """
    if unknown := [row for row in rows if row not in ROWS]:
        raise ValueError(f"benchmark: unknown row '{unknown[0]}'; known: {', '.join(ROWS)}")
    if repeats < 3:
        raise ValueError(f"benchmark: {repeats} repeats; quartiles need at least 3")
    found: list[BenchmarkRow] = []
    for row in rows:
        # Libraries take the number of cores from the process when they are first imported.
        with multiprocessing.get_context("spawn").Pool(1, _hold, (threads,)) as pool:
            found += pool.apply(_measure, (row, repeats, threads))
    return found


def _hold(threads: int) -> None:
    cores = sorted(os.sched_getaffinity(0))[-threads:]
    os.sched_setaffinity(0, cores)
    if threads == 1:
        os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
    import torch

    torch.set_num_threads(threads)


def _measure(row: str, repeats: int, threads: int) -> list[BenchmarkRow]:
    made = ROWS[row]()
    return [made] if isinstance(made, BenchmarkRow) else play(made, repeats, threads)


def play(match: Match, repeats: int, threads: int) -> list[BenchmarkRow]:
    """Time the contenders in turn, after one call of each that is not counted.

    A library that frees memory or winds up threads after its result is there does so in a pause,
    on its own account: the next contender would pay for it otherwise.
    """
    clock = time.process_time if threads == 1 else time.perf_counter
    contenders = [match.ours, *(peer for peer, _ in match.peers.values())]
    for one in contenders:
        one.work()
    speeds: list[list[float]] = [[] for _ in contenders]
    for _ in range(repeats):
        for one, found in zip(contenders, speeds, strict=True):
            began = clock()
            one.work()
            ended = clock()
            time.sleep(SETTLE)
            found.append(one.amount / ((clock() if threads == 1 else ended) - began))
    rows = []
    for (name, (_, bar)), theirs in zip(match.peers.items(), speeds[1:], strict=True):
        each = [a / b for a, b in zip(speeds[0], theirs, strict=True)]
        low, _, high = statistics.quantiles(each, n=4, method="inclusive")
        ours, peer = statistics.median(speeds[0]), statistics.median(theirs)
        rows.append(
            BenchmarkRow(
                row=match.row,
                peer=name,
                unit=match.unit,
                ours=ours,
                theirs=peer,
                ratio=ours / peer,
                low=low,
                high=high,
                bar=bar,
                reached=ours / peer >= bar,
                path=match.ours.path,
                threads=threads,
                clock="cpu" if threads == 1 else "wall",
                repeats=repeats,
            )
        )
    return rows


def _rolled(head: Any, steps: int, count: int = EPISODES) -> Contender:
    """A rollout of the shared episodes, as a contender."""
    import torch

    from vidphys.trade.contenders import episodes

    start, params = episodes(count)

    def work() -> Any:
        with torch.no_grad():
            return head.trajectory(start, params, steps, BODIES_DT)

    return Contender(work, count * steps, work().backend)


def _jax(gradient: str, head: Any, count: int = EPISODES, steps: int = SHORT) -> Contender:
    from vidphys.trade import peers
    from vidphys.trade.contenders import episodes

    pair = {"displacement": peers.plane_gradient, "radial": peers.radial_gradient}[gradient]
    start, params = episodes(count)
    work = peers.jax_leapfrog(pair, head.potential.phi, start, params, steps, BODIES_DT)
    return Contender(work, count * steps, "jax")


def compiled_factored() -> Match:
    """A compiled pair law against its own network in JAX, the gradient written by hand."""
    from dynamics.compiled import compile_head
    from vidphys.trade.contenders import fitted

    head = fitted("displacement", WIDTH)
    ours = _rolled(compile_head(head), LONG)
    peer = {"JAX scan, gradient by hand": (_jax("displacement", head), 100.0)}
    return Match("compiled factored", "episode-steps", ours, peer)


def compiled_radial() -> Match:
    """A compiled radial law against the networks in JAX, and against the true law in numba."""
    from dynamics.compiled import compile_head
    from vidphys.scenes.gravity import SOFTENING
    from vidphys.trade import peers
    from vidphys.trade.contenders import episodes, fitted

    head = fitted("radial", WIDTH)
    start, params = episodes(EPISODES)
    truth = peers.numba_truth(start, params, LONG, BODIES_DT, SOFTENING)
    factored = _jax("displacement", fitted("displacement", WIDTH))
    against = {
        "JAX scan, factored, gradient by hand": (factored, 200.0),
        "JAX scan, its own network, gradient by hand": (_jax("radial", head), 200.0),
        "true gravity in numba": (Contender(truth, EPISODES * LONG, "numba"), 0.8),
    }
    return Match(
        "compiled factored-radial", "episode-steps", _rolled(compile_head(head), LONG), against
    )


def network_factored() -> Match:
    """The network itself in the fused loop, against what others write; few episodes."""
    return _network_factored("network factored", EPISODES, SHORT)


def network_factored_many() -> Match:
    """The same for many episodes."""
    return _network_factored("network factored, 1,024 episodes", MANY_EPISODES, FEW)


def _network_factored(row: str, count: int, steps: int) -> Match:
    from vidphys.trade import peers
    from vidphys.trade.contenders import episodes, fitted

    head = fitted("displacement", WIDTH)
    start, params = episodes(count)
    user = peers.diffrax_rollout(head.potential.phi, start, params, steps, BODIES_DT)  # type: ignore[attr-defined]
    least = max(1, steps // 8)
    torch_user = peers.torchdiffeq_rollout(head, start, params, least, BODIES_DT)
    against = {
        "JAX scan, gradient by hand": (_jax("displacement", head, count, steps), 1.0),
        "diffrax, jax.grad": (Contender(user, count * steps, "jax"), 1.3),
        "torchdiffeq, RK4": (Contender(torch_user, count * least, "torch"), 6.0),
    }
    return Match(row, "episode-steps", _rolled(head, steps, count), against)


def network_unstructured() -> Match:
    """A transition map, which has no gradient, against the same products in JAX."""
    import torch

    from dynamics import HEADS, build
    from vidphys.trade import peers
    from vidphys.trade.contenders import episodes

    torch.manual_seed(0)
    head: Any = build(HEADS["unstructured"], bodies=3, dt=BODIES_DT)
    start, params = episodes(EPISODES)
    theirs = Contender(peers.jax_map(head, start, params, USUAL), EPISODES * USUAL, "jax")
    ours = _rolled(head, USUAL)
    return Match("network unstructured", "episode-steps", ours, {"JAX scan": (theirs, 1.0)})


def ten_seeds() -> Match:
    """Training steps of ten seeds side by side against one after another, width 64."""
    from vidphys.trade.training import together_and_apart

    together, apart = together_and_apart(seeds=10, width=64, batch=1024)
    ours = Contender(together, 10, "torch")
    peer = {"one after another": (Contender(apart, 10, "torch"), 1.5)}
    return Match("ten seeds together", "training steps", ours, peer)


def training_step() -> Match:
    """One training step of the factored model against JAX and against eager torch."""
    from vidphys.trade import peers
    from vidphys.trade.training import eager_step, our_step, problem

    made = problem(width=WIDTH, batch=1024)
    against = {
        "JAX, gradient by hand": (Contender(peers.jax_training(made), 1, "jax"), 1.8),
        "eager torch, double backward": (Contender(eager_step(made), 1, "torch"), 1.3),
    }
    ours = Contender(our_step(made), 1, "torch")
    return Match("training step", "training steps", ours, against)


def _deviation(name: str, plunge: bool) -> BenchmarkRow:
    """Compiled against float32 network: how far each strays from the float64 network."""
    from vidphys.trade.contenders import deviations, fitted

    found = deviations(fitted("displacement", WIDTH), plunge, LONG, BODIES_DT)
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


ROWS: dict[str, Callable[[], Match | BenchmarkRow]] = {
    "compiled-factored": compiled_factored,
    "compiled-radial": compiled_radial,
    "deviation-circular": deviation_circular,
    "deviation-close": deviation_close,
    "network-factored": network_factored,
    "network-factored-many": network_factored_many,
    "network-unstructured": network_unstructured,
    "training-step": training_step,
    "ten-seeds": ten_seeds,
}


def _lies_in(module: str, row: str) -> Callable[[], Match | BenchmarkRow]:
    """A row of another file, which is imported where it is measured."""
    return lambda: import_module(f"vidphys.trade.{module}").ROWS[row]()


_DRAWN = ("forward", "backward", "kept")
ROWS |= {
    name: _lies_in("renderer_rows", name)
    for name in (
        *(f"{kind}-{how}" for kind in ("gaussians", "disks") for how in _DRAWN),
        "gaussians-bandwidth",
    )
}
ROWS |= {
    name: _lies_in("guard_rows", name)
    for name in (f"guards-{head}-{count}" for head in ("exact", "factored") for count in (1, 64))
}
ROWS |= {
    name: _lies_in("encoder_rows", name)
    for name in ("dinov2", "dinov2-cached", "videomae", "videomae-cached")
}


def table(rows: Sequence[BenchmarkRow]) -> str:
    """The rows as plain text, one a line."""
    lines = []
    for row in rows:
        verdict = "reached" if row.reached else "missed"
        extra = "".join(f"; {name} {value:.3g}" for name, value in row.numbers.items())
        lines.append(
            f"{row.row} | {row.peer} | {row.ours:.4g} against {row.theirs:.4g} {row.unit} | "
            f"{row.ratio:.3g} ({row.low:.3g} to {row.high:.3g}) | bar {row.bar:g}: {verdict} | "
            f"{row.path}, {row.threads} thread(s), {row.clock}{extra}"
        )
    return "\n".join(lines)
