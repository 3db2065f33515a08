"""Bodies that swing in step are not told for sure as if each had a law of its own."""

import numpy as np
from scipy.integrate import solve_ivp

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.law_words import tied
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOSTLY
from vidphys.diagnose.telling.answers import answer
from vidphys.experiments.filmed.laws.law import GRAVITY

STEP, FRAMES, LENGTH = 1 / 60, 240, 0.4
CART, BOB = 1.0, 0.5


def slope(_, y):
    _, angle, v, turn = y
    sine, cosine = np.sin(angle), np.cos(angle)
    pull = BOB * sine * (LENGTH * turn**2 + GRAVITY * cosine) / (CART + BOB * sine**2)
    return [v, turn, pull, -(GRAVITY * sine + pull * cosine) / LENGTH]


def test_a_pendulum_and_the_cart_that_it_hangs_from():
    times = np.arange(FRAMES) * STEP
    cart, angle = solve_ivp(slope, (0, times[-1]), [0, 0.7, 0, 0], t_eval=times, rtol=1e-9).y[:2]
    bob = [cart + LENGTH * np.sin(angle), -LENGTH * np.cos(angle)]
    places = np.stack([np.stack([cart, 0 * cart], -1), np.stack(bob, -1)], 1)
    given = answer(noisy(places, 0.002, STEP), False, 0.3)
    assert given.data["status"] == MOSTLY and tied(0, 1) in given.lines


def test_springs_of_different_stiffness_are_not_in_step():
    times = np.arange(FRAMES) * STEP
    places = np.stack([0.1 * np.cos(3 * times), 0.5 + 0.1 * np.cos(3.4 * times)], -1)
    given = answer(noisy(places[..., None], 0.001, STEP), False, 0.3)
    assert given.data["status"] == EXPLAINED and tied(0, 1) not in given.lines
