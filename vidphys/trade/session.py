"""Measuring all fronts into a run folder, one after another, resumable."""

from __future__ import annotations

import os
import platform
import tempfile
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import torch

from vidphys.errors import InputError
from vidphys.points.pareto import by_task, pareto
from vidphys.points.point import Point, read_points, write_points
from vidphys.runs.code import code_version
from vidphys.runs.folder import RunFolder
from vidphys.trade.context import Context, TradeSizes
from vidphys.trade.measure import measure
from vidphys.trade.profile import read_profile, write_profile

FRONTS = (
    "rollouts",
    "learned",
    "forces",
    "drawing",
    "encoders",
    "runtimes",
    "readouts",
    "training",
    "pipeline",
)
FILES = {"drawing": "renderers"}  # where the file has another name than the front
Told = Callable[[str, int, int], None]


def choose(names: Sequence[str]) -> tuple[str, ...]:
    """The fronts of these names; all where none is given.

    Raises:
        InputError: there is none of this name.
    """
    for name in names:
        if name not in FRONTS:
            raise InputError(f"`fronts` {name}: no such front; there are {', '.join(FRONTS)}")
    return tuple(names) or FRONTS


def measure_fronts(
    run: RunFolder,
    fronts: Sequence[str],
    sizes: TradeSizes,
    seed: int,
    device: str,
    weights: Path | None,
    encoders: Sequence[str],
    told: Told,
) -> list[Point]:
    """Measure what is not in the run yet; write all points and the profile of their fronts.

    Args:
        run: its folder.
        fronts: names out of ``FRONTS``.
        sizes: how much is measured.
        seed: of all that is drawn.
        device: where networks run.
        weights: folder of encoders' weights.
        encoders: that are measured beside ours.
        told: called as ``(front, calls done, calls)``.
    """
    with tempfile.TemporaryDirectory() as scratch:
        context = Context(sizes, seed, device, weights, Path(scratch), tuple(encoders))
        for name in fronts:
            part = run.path / "parts" / f"{name}.points.parquet"
            if not part.exists():
                write_points(part, _measured(name, context, told))
        for what, why in context.skipped.items():
            run.skip(what, why)
    parts = sorted((run.path / "parts").glob("*.points.parquet"))
    points = [point for part in parts for point in read_points(part)]
    write_points(run.path / "points.parquet", points)
    best = [point for group in by_task(points).values() for point in pareto(group)]
    about = {"code_version": code_version(), **surroundings(device)}
    write_profile(run.path / "profile.json", about, best)
    return points


def _measured(name: str, context: Context, told: Told) -> list[Point]:
    front = import_module(f"vidphys.trade.fronts.{FILES.get(name, name)}")
    with warnings.catch_warnings():
        # a point that is too coarse is measured, not warned of
        warnings.simplefilter("ignore")
        jobs = list(front.jobs(context))
        return measure(
            front.SCALE,
            jobs,
            context.sizes.repeats,
            context.seed,
            context.device,
            lambda done, total: told(name, done, total),
        )


def surroundings(device: str) -> dict[str, Any]:
    """Machine and versions, as far as they decide how fast something is."""
    return {
        "torch": torch.__version__,
        "python": platform.python_version(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": torch.get_num_threads(),
        "device": torch.cuda.get_device_name() if device == "cuda" else "cpu",
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def load_points(path: Path) -> list[Point]:
    """The points of a run folder, or of a profile file.

    Raises:
        InputError: there is neither.
    """
    if path.is_dir():
        table = path / "points.parquet"
        if not table.is_file():
            raise InputError(f"trade: {path} has no measured points; measure them first")
        return read_points(table)
    if not path.exists():
        raise InputError(f"trade: nothing is measured in {path} yet; run `vidphys trade` first")
    return list(read_profile(path).points)


def surroundings_of(path: Path) -> dict[str, Any]:
    """Where the points of a run folder or a profile were measured."""
    return read_profile(path / "profile.json" if path.is_dir() else path).surroundings
