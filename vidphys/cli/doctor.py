"""``vidphys doctor``: what this machine has, for a bug report or a first look."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from dataclasses import dataclass

PACKAGES = ("torch", "numpy", "scipy", "timm", "transformers", "mujoco", "rerun-sdk", "vidphys")


@dataclass(frozen=True)
class DoctorConfig:
    """Say what this machine has.

    Example: vidphys doctor
    """


def doctor(_config: DoctorConfig) -> None:
    """Print versions, cores, devices and where weights are looked for."""
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
