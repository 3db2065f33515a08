"""What a run is made with: packages, threads and instructions; what of it has changed."""

from __future__ import annotations

import importlib.metadata
import platform
import warnings
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

PACKAGES = ("torch", "numpy", "scipy", "numba", "timm", "rerun-sdk", "vidphys")
MIXED = "mixed"


class MixedMachineWarning(UserWarning):
    """A run goes on with other packages, threads or instructions than it was begun with."""


def surroundings(threads: int | None = None) -> dict[str, Any]:
    """For ``run.json``.

    Args:
        threads: that compute; torch's own number of this process where none is given, and 0 where
            torch computes nothing: it is then not loaded to be asked.
    """
    return {
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": _versions(),
        "machine": _machine(threads),
    }


def mark_mixed(path: Path, manifest: dict[str, Any], threads: int | None = None) -> None:
    """Warn, once, and mark a run's manifest, where what it is made with has changed.

    Its numbers then need not be those of a run that was never interrupted. ``mixed`` holds every
    value of what has changed.
    """
    now = _versions() | _machine(threads)
    begun = manifest["versions"] | manifest.get("machine", {})
    mixed = manifest.get(MIXED, {})
    new = {
        name: sorted({*mixed.get(name, [str(begun[name])]), str(value)})
        for name, value in now.items()
        if name in begun and str(value) not in mixed.get(name, [str(begun[name])])
    }
    if new:
        manifest[MIXED] = {**mixed, **new}
        told = ", ".join(f"{name} {now[name]} (begun with {begun[name]})" for name in new)
        warnings.warn(
            f"run folder {path}: goes on with {told}; its numbers may differ in the last bits from "
            "those of one run; run.json says so",
            MixedMachineWarning,
            stacklevel=6,
        )


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def _machine(threads: int | None) -> dict[str, Any]:
    if threads == 0:
        return {"processor": _processor()}
    import torch

    return {
        "threads": torch.get_num_threads() if threads is None else threads,
        "instructions": torch.backends.cpu.get_cpu_capability(),
        "processor": _processor(),
    }


def _processor() -> str:
    """For which loops are compiled, where they are."""
    try:
        from llvmlite.binding import get_host_cpu_name
    except ImportError:
        return platform.machine()
    return get_host_cpu_name()
