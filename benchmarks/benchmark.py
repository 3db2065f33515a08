"""Our fast paths beside their peers: the rows, each measured in a process of its own."""

from __future__ import annotations

import multiprocessing
import os
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from benchmarks.match import BenchmarkRow

ROWS = {
    name: f"benchmarks.{file}:{name.replace('-', '_')}"
    for file, names in {
        "rollouts": (
            "compiled-factored",
            "compiled-ladder",
            "compiled-radial",
            "network-factored",
            "network-factored-many",
            "network-unstructured",
        ),
        "deviations": ("deviation-circular", "deviation-close"),
        "training": ("training-step", "ten-seeds"),
        "renderers": (
            "gaussians-forward",
            "gaussians-backward",
            "gaussians-kept",
            "disks-forward",
            "disks-backward",
            "disks-kept",
            "gaussians-bandwidth",
        ),
        "guards": ("guards-exact-1", "guards-exact-64", "guards-factored-1", "guards-factored-64"),
        "encoders": ("dinov2", "dinov2-cached", "videomae", "videomae-cached", "all-layers"),
        "extraction": ("extraction",),
    }.items()
    for name in names
}
"""The function that makes each row; its file is imported where the row is measured."""

CARD_ROWS = {
    name: f"benchmarks.card:{name.replace('-', '_')}"
    for name in (
        "network",
        "compiled",
        "training",
        "training-large",
        "gaussians",
        "gaussians-backward",
        "disks",
        "disks-backward",
        "features",
        "features-large",
    )
}
"""The same on a card."""


def run_benchmark(row: str, repeats: int, threads: int, device: str = "cpu") -> list[BenchmarkRow]:
    """Measure a row in a fresh process that is held to ``threads`` cores.

    Args:
        row: of :data:`ROWS` or :data:`CARD_ROWS`.
        repeats: interleaved rounds, at least 3.
        threads: 1 for one core.
        device: ``cuda`` for the rows of a card.

    Raises:
        KeyError: an unknown row.
        ValueError: fewer than 3 repeats.
        ImportError: a peer is not installed (the extra ``bench``).
    """
    rows = CARD_ROWS if device == "cuda" else ROWS
    # Libraries take the number of cores from the process when they are first imported: not here.
    with multiprocessing.get_context("spawn").Pool(1, _hold, (threads,)) as pool:
        return pool.apply(_measure, (rows[row], repeats, threads))


def _hold(threads: int) -> None:
    cores = sorted(os.sched_getaffinity(0))[-threads:]
    os.sched_setaffinity(0, cores)
    os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] = "false"  # of a card, which torch uses too
    if threads == 1:
        os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false"
    import torch

    torch.set_num_threads(threads)


def _measure(path: str, repeats: int, threads: int) -> list[BenchmarkRow]:
    from benchmarks.match import BenchmarkRow, play

    module, _, name = path.partition(":")
    made = getattr(import_module(module), name)()
    return [made] if isinstance(made, BenchmarkRow) else play(made, repeats, threads)
