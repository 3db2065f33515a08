"""F14: killed and resumed over and over, a training ends with the bits of an undisturbed one."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

HOME = Path(__file__).parents[2]
CYCLES = int(os.environ.get("VIDPHYS_FAULTS", "0"))  # `make faults` sets it
STEPS, EVERY = 40, 2
TRAIN = """
import os, sys, time
from pathlib import Path
import torch
from torch import nn
from vidphys.training.loop import FitSettings, fit
torch.manual_seed(0)
model = nn.Sequential(nn.Linear(3, 16), nn.Tanh(), nn.Linear(16, 1))
data = torch.randn(256, 3)
def loss(batch):
    time.sleep(float(sys.argv[2]))
    return (model(batch) - batch.sin().sum(-1, keepdim=True)).square().mean()
path = Path(sys.argv[1]) / "c.json"
steps = FitSettings(int(sys.argv[3]), 32, 1e-2, 1.0, save_every=int(sys.argv[4]))
print("began", flush=True)
fit(model, loss, data, steps, 7, path)
print("ended", flush=True)
"""


def train(folder: Path, pause: float, steps: int) -> subprocess.Popen:
    command = [sys.executable, "-c", TRAIN, str(folder), str(pause), str(steps), str(EVERY)]
    environment = {**os.environ, "PYTHONPATH": str(HOME), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


@pytest.mark.timeout(4000 if CYCLES else 300)
def test_f14_kills_and_resumes_end_with_the_bits_of_an_undisturbed_run(tmp_path):
    cycles, rng = CYCLES or 3, np.random.default_rng(0)
    steps = max(STEPS, 4 * cycles)
    for name in ("whole", "cut"):
        (tmp_path / name).mkdir()
    assert train(tmp_path / "whole", 0.0, steps).communicate()[0].endswith("ended\n")
    for _ in range(cycles):
        run = train(tmp_path / "cut", 0.02, steps)
        assert run.stdout is not None
        assert run.stdout.readline() == "began\n"
        time.sleep(float(rng.uniform(0.0, 0.25)))
        run.kill()
        run.communicate()
    assert train(tmp_path / "cut", 0.0, steps).communicate()[0].endswith("ended\n")
    name = f"c-{steps:08d}.safetensors"
    whole, cut = (load_file(tmp_path / folder / name) for folder in ("whole", "cut"))
    assert whole.keys() == cut.keys()
    assert all(whole[key].equal(cut[key]) for key in whole)
