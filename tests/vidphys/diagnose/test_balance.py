"""Bodies that act on each other keep the balance of their masses; others do not."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.diagnose.recordings.balance import masses_in_balance
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.telling.answers import answer

TIMES = np.arange(400) * 0.02
MASS = np.array([3.0, 1.0])


def pulled(field: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Two bodies that pull each other as 1 / r², and fall, ``(t, 2, 2)``."""

    def rates(_: float, state: np.ndarray) -> np.ndarray:
        q, v = state.reshape(2, 2, 2)
        apart = q[1] - q[0]
        force = 3.0 * apart / np.linalg.norm(apart) ** 3
        return np.concatenate(
            [v.ravel(), (np.stack([force, -force]) / MASS[:, None] + field).ravel()]
        )

    start = np.array([-0.3, 0, 0.9, 0, 0, -0.25, 0, 0.75])
    done = solve_ivp(rates, (0, TIMES[-1]), start, t_eval=TIMES, rtol=1e-10, atol=1e-10)
    return done.y[:4].T.reshape(-1, 2, 2)


def swings(*rates: float) -> np.ndarray:
    """Each body about a place of its own, ``(t, n, 2)``."""
    turns = [rate * TIMES + k for k, rate in enumerate(rates)]
    return np.stack([np.stack([np.cos(x), 0.6 * np.sin(x)], -1) for x in turns], 1)


def noisy(path: np.ndarray, sigma: float = 0.002) -> Motion:
    noise = sigma * np.random.default_rng(0).standard_normal(path.shape)
    return motion_of((path + noise)[None], float(TIMES[1]))


@pytest.mark.parametrize("field", [(0.0, 0.0), (0.3, -2.0)])
def test_masses_are_told_by_what_goes_straight_on_or_falls(field):
    mass = masses_in_balance(noisy(pulled(field)))
    assert mass is not None
    np.testing.assert_allclose(mass[0] / mass[1], 3.0, rtol=2e-3)
    assert np.log(mass).mean() == pytest.approx(0.0, abs=1e-12)


def test_what_is_not_seen_says_nothing():
    motion = noisy(pulled())
    motion.positions[0, 50:90, 1] = np.nan
    mass = masses_in_balance(motion)
    assert mass is not None and mass[0] / mass[1] == pytest.approx(3.0, rel=2e-3)
    motion.positions[0, :, 1] = np.nan
    assert masses_in_balance(motion) is None


@pytest.mark.parametrize("rates", [(3.0,), (3.0, 2.0), (3.0, 2.0, 2.5)])
def test_bodies_with_laws_of_their_own_keep_none(rates):
    assert masses_in_balance(noisy(swings(*rates))) is None


def test_two_that_fall_keep_none_that_shows():
    fall = np.stack([TIMES, 3 * TIMES - 4.9 * TIMES**2], -1)
    assert masses_in_balance(noisy(np.stack([fall, fall + [1.0, 0.0]], 1))) is None


def test_bodies_in_step_have_no_negative_masses():
    path = swings(3.0)[:, [0, 0]] * np.array([[[1.0], [0.5]]])
    assert masses_in_balance(noisy(path)) is None


def test_unequal_bodies_that_pull_each_other_are_told_so():
    told = answer(noisy(pulled()), False, 0.3)
    assert (told.data["status"], told.data["terms"]) == ("explained", ["pair"])
    ratio = told.specification["mass"][0] / told.specification["mass"][1]
    assert ratio == pytest.approx(3.0, rel=2e-3)


def test_laws_of_each_that_keep_a_balance_are_told_in_doubt():
    """A force between bodies that the menu lacks would look like this, and so would two springs."""
    path = swings(2.0)[:250, [0, 0]] * np.array([[[1.0], [-0.5]]]) + np.array([[[0.0], [3.0]]])
    told = answer(noisy(path), False, 0.3)
    assert (told.data["status"], told.data["terms"]) == ("mostly explained", ["trap"])
    assert any(
        "In doubt: with masses as 1 : 2 the bodies keep their balance" in x for x in told.lines
    )
