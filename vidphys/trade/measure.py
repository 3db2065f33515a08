"""Measured points of jobs: warm-up apart, repeats interleaved, medians and quartiles."""

from __future__ import annotations

import gc
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch

from vidphys.points.point import Point, Setting
from vidphys.trade.memory import peak_bytes
from vidphys.trade.timing import Timed, clock_of, in_turn, quartiles

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


@dataclass(frozen=True)
class _Warm:
    """A job after its first call: seconds, bytes and errors of that, and the timings to come."""

    job: Job
    timed: Timed
    seconds: float
    peak: int | None
    errors: dict[str, float]


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
    total, done = len(jobs) * (repeats + 1), 0

    def told() -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, total)

    warm = []
    for job in jobs:
        warm.append(_first(job, device))
        told()
    gc.collect()
    in_turn([one.timed for one in warm], repeats, device, told=told)
    return [_point(scale, one, seed, device) for one in warm]


def _first(job: Job, device: str) -> _Warm:
    """The warm-up: its time and memory, and the errors of what it gives."""
    began = time.perf_counter()
    result, peak = peak_bytes(job.work, device)
    warmup = time.perf_counter() - began
    errors = job.errors(result)
    del result
    calls = 1
    if warmup <= LONG:
        probe = Timed(job.work)
        probe.once(device)
        calls = max(1, math.ceil(SHORTEST / max(probe.wall[0], 1e-9)))
    return _Warm(job, Timed(job.work, calls), warmup, peak, errors)


def _point(scale: Scale, one: _Warm, seed: int, device: str) -> Point:
    job, clock = one.job, clock_of(device)
    unit = scale.per_second / job.per_call
    low, middle, high = quartiles([unit * x for x in one.timed.seconds(clock)])
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
        wall=unit * quartiles(one.timed.wall)[1],
        repeats=len(one.timed.wall),
        warmup_seconds=one.seconds,
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
