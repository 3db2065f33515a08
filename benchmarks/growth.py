"""How time and memory grow, along one axis after the other, with fitted exponents.

Run from a checkout: ``python -m benchmarks.growth [AXIS …]``; a line of JSON for each axis. Times
are the least of three, of the processor, with one thread. Memory (Linux) is what a piece of work
adds to the process at most.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch

from benchmarks.contenders import DT, RATE, episodes, fitted, problem
from dynamics import Hamiltonian, Head, Parameters, terms
from dynamics.compiled import compile_head
from dynamics.contact import SoftContact
from dynamics.neighbours import WithinReach
from dynamics.potentials import SoftenedGravity
from renderers import Camera, gaussians
from vidphys.training.ensemble import Ensemble, stack
from vidphys.training.segments import scale_of, segment_loss

Work = Callable[[], object]
ROUNDS = 3
BODIES = (3, 16, 64, 256, 1024, 4096)
LEAST_SECONDS = 1e-3  # below which a call's own cost hides how its work grows


@dataclass(frozen=True)
class Axis:
    """What grows.

    Args:
        sizes: along it.
        work: what is done at a size.
    """

    sizes: Sequence[int]
    work: Callable[[int], Work]


def _crowd(count: int) -> tuple[torch.Tensor, Parameters]:
    """Bodies at the same density however many they are."""
    rng = torch.Generator().manual_seed(count)
    q = count**0.5 * torch.randn(count, 2, generator=rng)
    return q, Parameters(torch.ones(()), torch.full((count,), 1.0 / count))


def _all_pairs(count: int) -> Work:
    (q, params), law = _crowd(count), SoftenedGravity(0.1)
    return lambda: law.force(q, params)


def _near_pairs(count: int) -> Work:
    (q, params), law = _crowd(count), WithinReach(SoftContact(0.5), 1.0)
    return lambda: law.force(q, params)


@cache
def _law() -> Hamiltonian:
    return compile_head(fitted(terms.Radial(width=64)))


def _rolled(count: int, steps: int) -> Work:
    (start, params), law = episodes(count), _law()
    return lambda: law.trajectory(start, params, steps, DT)


def _drawn(frames: int, side: int) -> Work:
    q = torch.rand(frames, 3, 2, generator=torch.Generator().manual_seed(0)) - 0.5
    return lambda: gaussians(6.0 * q, Camera(4.0, side, side), 0.32)


def _trained(seeds: int) -> Work:
    made = [problem(64, 256, seed) for seed in range(seeds)]
    scale, every = scale_of(made[0].segments), stack([one.segments for one in made])
    ensemble: Ensemble[Head] = Ensemble([one.head.requires_grad_() for one in made])
    loss = ensemble.loss(lambda head, batch: segment_loss(head, scale)(batch))
    adam = torch.optim.Adam(ensemble.parameters(), RATE)

    def step() -> None:
        adam.zero_grad()
        loss(every).backward()
        adam.step()

    return step


AXES = {
    "bodies, all pairs (a force)": Axis(BODIES, _all_pairs),
    "bodies, pairs within reach (a force)": Axis((*BODIES, 16_384, 65_536), _near_pairs),
    "episodes (100 steps)": Axis((1, 8, 64, 512, 4096, 32_768), lambda n: _rolled(n, 100)),
    "steps (16 episodes)": Axis((100, 1000, 10_000, 100_000), lambda n: _rolled(16, n)),
    "pixels of a side (16 frames)": Axis((16, 64, 128, 256, 512, 1024), lambda n: _drawn(16, n)),
    "frames (112 px)": Axis((8, 64, 512, 2048), lambda n: _drawn(n, 112)),
    "seeds (a training step)": Axis((1, 2, 4, 8, 16, 32), _trained),
}


def _status(name: str) -> int:
    """MiB that the system counts of this process."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) // 2**10


def measured(work: Work) -> tuple[float, int]:
    """Seconds, and MiB that it adds at most."""
    work()
    Path("/proc/self/clear_refs").write_text("5", encoding="utf-8")  # the peak counts from here
    before, seconds = _status("VmRSS"), []
    for _ in range(ROUNDS):
        began = time.process_time()
        work()
        seconds.append(time.process_time() - began)
    return min(seconds), _status("VmHWM") - before


def exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float | None:
    """Slope of the logarithms where the work takes its time; ``None`` of less than two sizes."""
    known = [(n, s) for n, s in zip(sizes, seconds, strict=True) if s > LEAST_SECONDS]
    if len(known) < 2:
        return None
    x, y = np.log(np.asarray(known)).T
    return float(np.polyfit(x, y, 1)[0])


def run(names: Sequence[str]) -> None:
    """Measure these axes, or all."""
    torch.set_num_threads(1)
    for name in names or AXES:
        axis = AXES[name]
        found = []
        for size in axis.sizes:
            work = axis.work(size)
            with torch.set_grad_enabled(axis.work is _trained):
                found.append(measured(work))
        seconds, peaks = zip(*found, strict=True)
        told = {"axis": name, "sizes": axis.sizes, "seconds": seconds, "added_mib": peaks}
        print(json.dumps({**told, "exponent": exponent(axis.sizes, seconds)}), flush=True)


if __name__ == "__main__":
    run(sys.argv[1:])
