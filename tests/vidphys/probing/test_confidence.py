import numpy as np
import pytest

from vidphys.probing.confidence import calibrated, calibration_error

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("loud", [0.01, 1.0, 100.0])
def test_a_known_law_of_chance_is_found_again_whatever_the_scale(loud):
    scores = RNG.normal(size=(20000, 3))
    chance = np.exp(2 * scores + [0.5, 0.0, -1.0])
    chance /= chance.sum(1, keepdims=True)
    true = (RNG.uniform(size=(20000, 1)) > chance.cumsum(1)).sum(1)
    found = calibrated(loud * scores + 7, np.eye(3)[true])
    assert found.slope * loud == pytest.approx(2, rel=0.05)
    assert found(loud * scores + 7) == pytest.approx(chance, abs=0.03)
    assert calibration_error(found(loud * scores + 7), true) < 0.02


def test_a_score_never_speaks_against_its_own_class():
    """Left out of its own mean, an example's score is lower for its class: that is no evidence."""
    true = np.eye(2)[RNG.integers(2, size=200)]
    assert calibrated(-true, true).slope == 0


def test_a_class_that_never_came_stays_possible_and_finite():
    true = np.eye(3)[RNG.integers(2, size=50)]
    told = calibrated(RNG.normal(size=(50, 3)), true)(np.zeros((1, 3)))
    assert np.isfinite(told).all() and 0 < told[0, 2] < 0.05


def test_overconfidence_is_measured():
    right = np.array([0] * 6 + [1] * 4)
    assert calibration_error(np.tile([0.9, 0.1], (10, 1)), right) == pytest.approx(0.3)
    assert calibration_error(np.tile([0.6, 0.4], (10, 1)), right) == pytest.approx(0, abs=1e-12)
