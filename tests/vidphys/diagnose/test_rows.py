"""Masses in a row on springs: the last or the middle one is held by the springs between them."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynamics import Parameters, PhaseState, build, from_config, rollout
from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.telling.answered import Answered
from vidphys.diagnose.telling.answers import answer

STEP, FRAMES, DAMPING = 1 / 60, 480, 0.1
WALL, BETWEEN = 30.0, 18.0  # stiffness of the springs to the walls, and of those between
IN_SERIES = np.array([1.0, 1.3]), np.array([WALL, 0.0]), [0.05, 0.12]
IN_A_ROW = np.array([1.0, 0.8, 1.1]), np.array([WALL, 0.0, WALL]), [0.12, 0.0, -0.03]


def moved(mass: np.ndarray, walls: np.ndarray, begin: list[float]) -> np.ndarray:
    """Places ``(t, n)`` of masses on a rail, by another's integrator."""

    def slope(_: float, y: np.ndarray) -> np.ndarray:
        q, v = np.split(y, 2)
        stretched = BETWEEN * np.diff(q)
        force = np.append(stretched, 0) - np.append(0, stretched) - walls * q
        return np.concatenate([v, force / mass - DAMPING * v])

    start, times = np.concatenate([begin, 0 * mass]), np.arange(FRAMES) * STEP
    found = solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-10, atol=1e-12)
    return found.y[: len(mass)].T + 0.4 * np.arange(len(mass))


def rolled(given: Answered, path: np.ndarray) -> np.ndarray:
    """By the model of an answer, from where the true motion starts at rest, ``(t, n)``."""
    head = build(from_config(given.specification["terms"]), path.shape[1], STEP / 8, 1).double()
    state = PhaseState(torch.tensor(path[:1, :, None]), torch.zeros(1, path.shape[1], 1).double())
    law = Parameters(torch.ones(1).double(), torch.tensor([given.specification["mass"]]).double())
    found = rollout(head, state, law, 8 * (FRAMES - 1), STEP / 8, 8)
    return found.states.q[0, :, :, 0].detach().numpy()


@pytest.mark.parametrize(
    ("mass", "walls", "begin"), [IN_SERIES, pytest.param(*IN_A_ROW, marks=pytest.mark.slow)]
)
def test_masses_in_a_row_are_told_with_the_springs_between_them(mass, walls, begin):
    path = moved(mass, walls, begin)
    given = answer(noisy(path[..., None], 0.001, STEP), False, 0.3)
    assert given.data["terms"] == ["linear", "pair", "trap"]
    assert given.data["status"] == EXPLAINED
    told = given.data["mechanism"][0]["quantities"]
    several = len(mass) > 2
    truth = {f"rate {i + 1}": np.sqrt(k / mass[i]) for i, k in enumerate(walls) if k}
    for i in range(1, len(mass)):
        between = "rate of the spring between" + (f" {i} and {i + 1}" if several else "")
        truth[between] = np.sqrt(BETWEEN * (1 / mass[i - 1] + 1 / mass[i]))
        truth["mass ratio" + (f" {i + 1}" if several else "")] = mass[i] / mass[0]
    for name, value in truth.items():
        off = abs(told[name]["value"] - value)
        assert off < 3.5 * told[name]["standard_error"] < 0.05 * value
    assert [name for name in told if name.startswith("rate ") and "spring" not in name] == [
        f"rate {i + 1}" for i in np.flatnonzero(walls)
    ]
    assert any("nothing else pulls body 2" in line for line in given.lines)
    assert np.abs(rolled(given, path) - path).max() < 0.01
