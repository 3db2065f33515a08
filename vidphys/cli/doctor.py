"""``vidphys doctor``: what this machine has, for a bug report or a first look."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import sysconfig
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.machinery import ModuleSpec
from pathlib import Path

PACKAGES = (
    "torch",
    "torchvision",
    "numpy",
    "scipy",
    "timm",
    "transformers",
    "mujoco",
    "rerun-sdk",
    "vidphys",
)
SHOWN = 10  # files that are not as they were installed


@dataclass(frozen=True)
class DoctorConfig:
    """Say what this machine has.

    Example: vidphys doctor

    Args:
        json: print it as JSON, for a script.
    """

    json: bool = False


def doctor(config: DoctorConfig) -> int:
    """Print versions, cores, devices, where weights are looked for, and whose the files are.

    Returns:
        0, or 1 where packages or files are not as they were installed.
    """
    from vidphys.cli import STAGES
    from vidphys.cli.owners import changed, others

    machine, taken, altered = _machine(), others(("vidphys", *STAGES)), changed()
    if config.json:
        print(json.dumps({**machine, "name taken": taken, "changed": altered}))
    else:
        for name, value in machine.items():
            print(f"{name:<14}{value}")
        _installation(taken, altered)
    return 1 if taken or altered else 0


def _machine() -> dict[str, str]:
    import torch

    from vidphys.runs.code import code_version

    return {
        "code": str(code_version()),
        "python": f"{platform.python_version()} on {platform.platform()}",
        **{name: importlib.metadata.version(name) for name in PACKAGES},
        "cores": f"{os.cpu_count()} (torch uses {torch.get_num_threads()})",
        "cuda": torch.cuda.get_device_name() if torch.cuda.is_available() else "none",
        "weights from": os.environ.get("VIDPHYS_WEIGHTS", "VIDPHYS_WEIGHTS is not set"),
        "bytecode": _bytecode(torch.__spec__),
    }


def _bytecode(imported: ModuleSpec | None) -> str:
    """Whether Python kept what it compiled of an imported module, or must do so each time."""
    if imported is None or imported.cached is None or Path(imported.cached).exists():
        return "kept"
    return (
        "not kept, so every command takes seconds longer: unset PYTHONDONTWRITEBYTECODE, or run "
        f"python -m compileall -q {sysconfig.get_path('purelib')}"
    )


def _installation(taken: Mapping[str, Sequence[str]], altered: Sequence[str]) -> None:
    """Print whose the installed packages and files are."""
    for name, who in taken.items():
        print(f"name taken    {name}, by {', '.join(who)}: uninstall it, install vidphys again")
    for file in altered[:SHOWN]:
        print(f"changed       {file}: not as it was installed")
    if len(altered) > SHOWN:
        print(f"changed       {len(altered) - SHOWN} more")
    if not taken and not altered:
        print("installation  as it was installed, and no other distribution has its names")
