"""``vidphys doctor``: what this machine has, for a bug report or a first look."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from dataclasses import dataclass

PACKAGES = ("torch", "numpy", "scipy", "timm", "transformers", "mujoco", "rerun-sdk", "vidphys")
SHOWN = 10  # files that are not as they were installed


@dataclass(frozen=True)
class DoctorConfig:
    """Say what this machine has.

    Example: vidphys doctor
    """


def doctor(_config: DoctorConfig) -> int:
    """Print versions, cores, devices, where weights are looked for, and whose the files are."""
    import torch

    from vidphys.runs.code import code_version

    print(f"code          {code_version()}")
    print(f"python        {platform.python_version()} on {platform.platform()}")
    for name in PACKAGES:
        print(f"{name:<14}{importlib.metadata.version(name)}")
    print(f"cores         {os.cpu_count()} (torch uses {torch.get_num_threads()})")
    cuda = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    print(f"cuda          {cuda}")
    print(f"weights from  {os.environ.get('VIDPHYS_WEIGHTS', 'VIDPHYS_WEIGHTS is not set')}")
    return _installation()


def _installation() -> int:
    """Print whose the installed packages and files are; 1 where some are not ours."""
    from vidphys.cli import STAGES
    from vidphys.cli.owners import changed, others

    taken, altered = others(("vidphys", *STAGES)), changed()
    for name, who in taken.items():
        print(f"name taken    {name}, by {', '.join(who)}: uninstall it, install vidphys again")
    for file in altered[:SHOWN]:
        print(f"changed       {file}: not as it was installed")
    if len(altered) > SHOWN:
        print(f"changed       {len(altered) - SHOWN} more")
    if taken or altered:
        return 1
    print("installation  as it was installed, and no other distribution has its names")
    return 0
