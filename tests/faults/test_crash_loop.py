"""F14: killed and resumed over and over, a training ends with the bits of an undisturbed one."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import nn

from vidphys.training.loop import FitSettings, fit

CYCLES = int(os.environ.get("VIDPHYS_FAULTS", "0")) or 6  # `make faults` sets it
STEPS = 10 * CYCLES
SETTINGS = FitSettings(STEPS, 32, 1e-2, 1.0, save_every=2)


def train(folder: Path, pause: float) -> None:
    torch.manual_seed(0)
    model = nn.Sequential(nn.Linear(3, 16), nn.Tanh(), nn.Linear(16, 1))
    data = torch.randn(256, 3)

    def loss(batch):
        time.sleep(pause)
        return (model(batch) - batch.sin().sum(-1, keepdim=True)).square().mean()

    fit(model, loss, data, SETTINGS, 7, folder / "c.json")


def killed(folder: Path, seconds: float) -> int:
    """A process that trains and is killed; the signal that it ended by, 0 of none."""
    child = os.fork()
    if child == 0:
        train(folder, 0.01)
        os._exit(0)
    time.sleep(seconds)
    os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.timeout(2000)
def test_f14_kills_and_resumes_end_with_the_bits_of_an_undisturbed_run(tmp_path):
    rng, name = np.random.default_rng(0), f"c-{STEPS:08d}.safetensors"
    for folder in ("whole", "cut"):
        (tmp_path / folder).mkdir()
    train(tmp_path / "whole", 0.0)
    ends = [killed(tmp_path / "cut", float(rng.uniform(0.02, 0.2))) for _ in range(CYCLES)]
    assert -signal.SIGKILL in ends
    train(tmp_path / "cut", 0.0)
    whole, cut = (load_file(tmp_path / folder / name) for folder in ("whole", "cut"))
    assert whole.keys() == cut.keys()
    assert all(whole[key].equal(cut[key]) for key in whole)
