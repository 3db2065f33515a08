"""Timing side by side: calls in turn, by the wall clock and by the time of the process."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from vidphys.points.point import CPU_CLOCK, WALL_CLOCK


@dataclass
class Timed:
    """What is called in turn with others, and how long a call took.

    Args:
        work: one call.
        calls: within one timing, for what is shorter than a clock can tell.
        cpu, wall: seconds a call, of the process and by the wall clock, one for each timing.
    """

    work: Callable[[], Any]
    calls: int = 1
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)

    def seconds(self, clock: str) -> list[float]:
        """Of each timing, by one of the two clocks."""
        return self.cpu if clock == CPU_CLOCK else self.wall

    def once(self, device: str = "cpu", settle: float = 0.0) -> None:
        """Time it once.

        Args:
            device: calls on CUDA are waited for.
            settle: seconds of a pause afterwards, whose work counts as time of the process. A
                library that frees memory or winds up threads after its result is there does so
                then, on its own account: the next in turn would pay for it otherwise.
        """
        _wait(device)
        wall, cpu = time.perf_counter(), time.process_time()
        for _ in range(self.calls):
            self.work()
        _wait(device)
        self.wall.append((time.perf_counter() - wall) / self.calls)
        if settle:
            time.sleep(settle)
        self.cpu.append((time.process_time() - cpu) / self.calls)


def in_turn(
    every: Sequence[Timed],
    rounds: int,
    device: str = "cpu",
    settle: float = 0.0,
    told: Callable[[], None] = lambda: None,
) -> None:
    """Time all in turn, again and again, so that what slows the machine slows each of them.

    Args:
        every: what is timed.
        rounds: at least 3: quartiles of fewer say nothing.
        device, settle: see :meth:`Timed.once`.
        told: called after each timing.

    Raises:
        ValueError: fewer than 3 rounds.
    """
    if rounds < 3:
        raise ValueError(f"in_turn: {rounds} rounds; quartiles need at least 3")
    for _ in range(rounds):
        for one in every:
            one.once(device, settle)
            told()


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def clock_of(device: str) -> str:
    """Time of the process where one thread does all the work, else the wall clock.

    On a shared machine the wall clock measures the neighbours as well; with several threads or a
    second device, the time of the process measures something else.
    """
    return CPU_CLOCK if device == "cpu" and torch.get_num_threads() == 1 else WALL_CLOCK


def quartiles(values: Sequence[float]) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile."""
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return low, middle, high
