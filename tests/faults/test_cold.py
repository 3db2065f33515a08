"""F2: what a process compiles itself rounds as what another one kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).parents[2]
FORWARD = """
import torch
from dynamics.compiled.gradient import input_gradient
torch.manual_seed(0)
shapes = (512, 4), (64, 4), (64,), (64, 64), (64,), (1, 64)
x, *weights = (0.3 * torch.randn(*shape) for shape in shapes)
print(input_gradient(x, *weights).numpy().tobytes().hex())
"""


@pytest.mark.timeout(400)
def test_f2_the_first_process_after_an_installation_rounds_as_every_later_one(tmp_path):
    where = {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(HOME)}
    found = [
        subprocess.run(
            [sys.executable, "-c", FORWARD],
            env={**os.environ, **where},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert list(tmp_path.rglob("*.nbc"))
    assert found[0] == found[1]
