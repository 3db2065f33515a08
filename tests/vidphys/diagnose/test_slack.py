"""A weight that is swung on a string too slowly to go over the top: it falls, and is caught."""

import numpy as np
import pytest

from tests.vidphys.diagnose.modelled import modelled
from tests.vidphys.diagnose.test_mechanisms import noisy, swing
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.kernels.string import swung
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.recorded.curves import SLACK

LENGTH, DAMPING, STEP = 0.4, 0.06, 1 / 60


def thrown(over: float, frames: int = 240) -> np.ndarray:
    """Places ``(t, 1, 2)`` by another's integrator; ``over`` is the squared speed over g l."""
    speed = np.sqrt(over * GRAVITY * LENGTH)
    return SLACK.path(np.array([LENGTH, DAMPING, speed]), np.arange(frames) * STEP)


@pytest.mark.parametrize("over", [2.8, pytest.param(4.0, marks=pytest.mark.slow)])
def test_a_weight_whose_string_goes_slack(over):
    path = thrown(over) + [0.3, 0.1]
    given = answer(noisy(path, 0.001, STEP), False, 0.3)
    assert given.data["terms"] == ["linear", "string"] and given.data["status"] == EXPLAINED
    told = given.data["mechanism"][0]["quantities"]
    truth = {"length": LENGTH, "acceleration": GRAVITY, "linear friction": DAMPING}
    for name, value in truth.items():
        assert told[name]["value"] == pytest.approx(value, rel=0.1 if "friction" in name else 0.01)
    off = np.linalg.norm(modelled(given, path[:, 0], STEP) - path[:, 0], axis=1)
    assert off[: len(off) // 2].max() < 0.02 * LENGTH and off.max() < 0.1 * LENGTH


def test_the_kernel_lets_go_and_catches_as_another_integrator_does():
    times, speed = np.arange(90) * STEP, np.sqrt(3.2 * GRAVITY * LENGTH)
    start = np.array([[0.0, -LENGTH], [speed, 0.0]])
    string, force = np.array([0.0, 0.0, LENGTH]), np.array([0.0, -GRAVITY])
    rolled = swung(times, start, string, force, DAMPING, 1e-4)
    far = np.linalg.norm(rolled[:, 0], axis=1)
    assert far.min() < 0.9 * LENGTH and far.max() < LENGTH * (1 + 1e-9)
    assert rolled[:, 0] == pytest.approx(thrown(3.2, 90)[:, 0], abs=1e-3 * LENGTH)


def test_a_string_that_stays_taut_is_a_pendulum():
    angle = swing(GRAVITY / LENGTH, DAMPING, 1.2, 240, step=STEP)
    places = LENGTH * np.stack([np.sin(angle), -np.cos(angle)], -1)
    given = answer(noisy(places[:, None], 0.001, STEP), False, 0.3)
    assert given.data["terms"] == ["linear", "pendulum"]
