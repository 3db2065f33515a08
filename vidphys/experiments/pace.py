"""How long this machine takes for the kind of work that units do: a measure of half a second."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from loops.threads import held_to

SECONDS = 0.5  # of the measure
BODIES, WIDTH, BATCH = 6, 128, 256  # numbers of a state, of a law's network, and states a step
RATE = 1e-4
CLIPS, PIXELS, CHANNELS = 8, 32, 16
BUSY = "import time\nend = time.monotonic() + {}\nwhile time.monotonic() < end: pass"


def step_seconds(workers: int) -> float:
    """Seconds of a step of training on one thread, of a law and of a small network that sees.

    Other processes keep as many cores busy meanwhile as the other workers will; what else the
    machine has to do counts as it is now.

    Args:
        workers: that will share this machine.
    """
    with torch.random.fork_rng(devices=[]):  # weights are drawn from the global generator
        step = _step()
    with held_to(1), _busy(min(workers, os.cpu_count() or 1) - 1):
        step()  # the first one prepares
        began, steps = time.perf_counter(), 0
        while (passed := time.perf_counter() - began) < SECONDS:
            step()
            steps += 1
    return passed / steps


def _step() -> Callable[[], None]:
    draws = torch.Generator().manual_seed(0)
    law = nn.Sequential(nn.Linear(BODIES, WIDTH), nn.Tanh(), nn.Linear(WIDTH, WIDTH), nn.Tanh())
    law.append(nn.Linear(WIDTH, 1))
    sight = nn.Sequential(nn.Conv2d(3, CHANNELS, 3), nn.GELU(), nn.Conv2d(CHANNELS, CHANNELS, 3))
    states = torch.randn(BATCH, BODIES, generator=draws).requires_grad_()
    frames = torch.randn(CLIPS, 3, PIXELS, PIXELS, generator=draws)
    weights = [*law.parameters(), *sight.parameters()]

    def step() -> None:
        energy: Tensor = law(states).sum()
        (force,) = torch.autograd.grad(energy, states, create_graph=True)
        loss = force.square().mean() + sight(frames).square().mean()
        slopes = torch.autograd.grad(loss, weights, materialize_grads=True)
        with torch.no_grad():
            for weight, slope in zip(weights, slopes, strict=True):
                weight.sub_(slope, alpha=RATE)

    return step


@contextmanager
def _busy(count: int) -> Iterator[None]:
    """So many processes that do nothing, with all their might."""
    asked = [sys.executable, "-S", "-c", BUSY.format(10 * SECONDS)]  # each ends if nobody ends it
    others = [subprocess.Popen(asked) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()
