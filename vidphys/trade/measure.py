"""Timing of jobs side by side: warm-up apart, repeats interleaved, medians and quartiles."""

from __future__ import annotations

import gc
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from vidphys.points.point import CPU_CLOCK, WALL_CLOCK, Point, Setting
from vidphys.trade.memory import peak_bytes

SHORTEST = 2e-3  # seconds: a shorter call is repeated within one timing
LONG = 0.5  # seconds: a longer first call tells that the others are no shorter than that


@dataclass(frozen=True)
class Job:
    """Something that can be done again and again at the same cost.

    Args:
        task: see :class:`vidphys.points.point.Point`.
        configuration: what is set.
        work: one call; returns what the errors are computed from.
        errors: of what the first call returned, by name; the front's own error among them.
        per_call: units of the cost's work (frames, clips, steps) in one call.
        dtype: of the computation.
        units: machine-independent cost of one unit of work, by name.
    """

    task: str
    configuration: dict[str, Setting]
    work: Callable[[], Any]
    errors: Callable[[Any], dict[str, float]]
    per_call: float
    dtype: str
    units: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Scale:
    """How a front's points are named.

    Args:
        front: name.
        cost_name: of the cost, unit included.
        per_second: of the cost's unit of time (1e3 for milliseconds).
        error_name: of the error.
        reference: what errors are measured against.
    """

    front: str
    cost_name: str
    per_second: float
    error_name: str
    reference: str


@dataclass
class _Timed:
    job: Job
    warmup: float
    inner: int
    errors: dict[str, float]
    peak: int | None
    cpu: list[float] = field(default_factory=list)
    wall: list[float] = field(default_factory=list)


def measure(
    scale: Scale,
    jobs: Sequence[Job],
    repeats: int,
    seed: int,
    device: str,
    progress: Callable[[int, int], None] | None = None,
) -> list[Point]:
    """Time jobs side by side; one that fails (``FloatingPointError``) has a point without error.

    Args:
        scale: see :class:`Scale`.
        jobs: of one front.
        repeats: timed calls of each job, at least 3: quartiles of fewer say nothing.
        seed: noted in the points.
        device: likewise; calls on CUDA are waited for.
        progress: called as ``(calls done, calls)``.

    Raises:
        ValueError: fewer than 3 repeats.
    """
    if repeats < 3:
        raise ValueError(f"measure: {repeats} repeats; quartiles need at least 3")
    total, done = len(jobs) * (repeats + 1), 0
    timed = []
    for job in jobs:
        timed.append(_first(job, device))
        done = _tell(progress, done, total)
    gc.collect()
    for _ in range(repeats):
        for one in timed:
            wall, cpu = _clocked(one.job.work, one.inner, device)
            one.wall.append(wall)
            one.cpu.append(cpu)
            done = _tell(progress, done, total)
    return [_point(scale, one, seed, device) for one in timed]


def _tell(progress: Callable[[int, int], None] | None, done: int, total: int) -> int:
    if progress is not None:
        progress(done + 1, total)
    return done + 1


def _first(job: Job, device: str) -> _Timed:
    """The warm-up: its time and memory, and the errors of what it gives."""
    began = time.perf_counter()
    result, peak = peak_bytes(job.work, device)
    warmup = time.perf_counter() - began
    errors = job.errors(result)
    del result
    if warmup > LONG:
        return _Timed(job, warmup, 1, errors, peak)
    took, _ = _clocked(job.work, 1, device)
    return _Timed(job, warmup, max(1, math.ceil(SHORTEST / max(took, 1e-9))), errors, peak)


def _clocked(work: Callable[[], Any], calls: int, device: str) -> tuple[float, float]:
    """Seconds a call by the wall clock and of the process."""
    _wait(device)
    wall, cpu = time.perf_counter(), time.process_time()
    for _ in range(calls):
        work()
    _wait(device)
    return (time.perf_counter() - wall) / calls, (time.process_time() - cpu) / calls


def _wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def clock_of(device: str) -> str:
    """Time of the process where one thread does all the work, else the wall clock.

    On a shared machine the wall clock measures the neighbours as well; with several threads or a
    second device, the time of the process measures something else.
    """
    return CPU_CLOCK if device == "cpu" and torch.get_num_threads() == 1 else WALL_CLOCK


def _point(scale: Scale, one: _Timed, seed: int, device: str) -> Point:
    job, clock = one.job, clock_of(device)
    unit = scale.per_second / job.per_call
    costs = [unit * x for x in (one.cpu if clock == CPU_CLOCK else one.wall)]
    low, middle, high = statistics.quantiles(costs, n=4, method="inclusive")
    errors = dict(one.errors)
    error = errors.pop(scale.error_name)
    return Point(
        front=scale.front,
        task=job.task,
        configuration=job.configuration,
        cost_name=scale.cost_name,
        cost=middle,
        cost_low=low,
        cost_high=high,
        clock=clock,
        wall=unit * statistics.median(one.wall),
        repeats=len(costs),
        warmup_seconds=one.warmup,
        peak_bytes=one.peak,
        error_name=scale.error_name,
        error=error if math.isfinite(error) else None,
        reference=scale.reference,
        seed=seed,
        device=device,
        dtype=job.dtype,
        threads=torch.get_num_threads(),
        units=job.units,
        errors={name: value for name, value in errors.items() if math.isfinite(value)},
    )
