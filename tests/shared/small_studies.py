"""Sizes of a study that a test can wait for."""

from functools import partial

import pytest

from vidphys.experiments.core import question
from vidphys.presets import OracleSizes, PixelSizes, Preset
from vidphys.scenes import lyapunov_time

TINY = Preset(
    seeds=1,
    oracle=OracleSizes(32, 12, 64, (5e-3,), 4),
    pixel=PixelSizes(
        clips=10,
        frames=9,
        stride=40,
        image=32,
        perception_steps=3,
        perception_batch=8,
        track_steps=4,
        held_out=4,
    ),
)
ROUNDS, STEPS = 4, 25  # of a Lyapunov time; 100 of 100 steps cost more than all else here


def with_short_lyapunov_times(monkeypatch: pytest.MonkeyPatch) -> None:
    short = partial(lyapunov_time, rounds=ROUNDS, steps=STEPS)
    monkeypatch.setattr(question, "lyapunov_time", short)
