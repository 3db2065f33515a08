"""Places that are counted from far away, as those of a map, are diagnosed as others are."""

import numpy as np
import pytest

from tests.vidphys.diagnose.test_encounters import INTERVAL, NOISE
from vidphys.diagnose.inference.search import infer
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.nearby import from_nearby
from vidphys.diagnose.telling.answers import answer

T = np.arange(300) * INTERVAL
ON_A_MAP = np.array([5.1e5, 4.2e6])  # metres, as a map has them


def on_springs() -> np.ndarray:
    """Two bodies that springs hold to one place and to each other, ``(1, t, 2, 2)``."""
    together = np.stack([np.cos(1.4 * T), 0.5 * np.sin(1.4 * T)], -1)
    against = np.stack([0.4 * np.sin(3.7 * T), 0.6 * np.cos(3.7 * T)], -1)
    noise = NOISE * np.random.default_rng(0).standard_normal((len(T), 2, 2))
    return (np.stack([together + against, together - against], 1) + noise)[None]


def test_a_place_nearby_is_round_and_told_only_of_what_is_far():
    motion = motion_of(on_springs() + ON_A_MAP, INTERVAL)
    near, place = from_nearby(motion)
    assert place.tolist() == ON_A_MAP.tolist() and np.abs(near.positions).max() < 2
    assert from_nearby(motion_of(on_springs() + 20.0, INTERVAL))[1] is None


def test_bodies_on_a_map_are_told_as_those_at_the_origin():
    given = answer(motion_of(on_springs() + ON_A_MAP, INTERVAL), False, 0.3)
    at_origin = answer(motion_of(on_springs(), INTERVAL), False, 0.3)
    assert given.data["terms"] == at_origin.data["terms"]
    assert given.data["counted_from"] == ON_A_MAP.tolist()
    shift = np.subtract(given.specification["origin"], at_origin.specification["origin"])
    np.testing.assert_allclose(shift, ON_A_MAP)


@pytest.mark.parametrize("apart", [0.0, 30.0])
def test_bodies_far_apart_are_no_reason_to_see_less_of_each(apart):
    """What rounding may be goes with how far they move, not with how far apart they are."""
    fall = np.stack([0.2 * T, -0.05 * T**2], -1)
    away = apart * np.array([[1.0, 0.0], [0.0, 1.0]])
    places = fall[:, None] + away + 1e-4 * np.random.default_rng(0).normal(size=(len(T), 2, 2))
    assert infer(motion_of(places[None], INTERVAL)).kinds == {"uniform"}
