"""What walks by at an even speed is left out beside a body that a force moves, and only there."""

import numpy as np
import pytest

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies
from vidphys.diagnose.mechanisms.bodies.passers import passes_by

TIMES = np.arange(120) / 30
ALONG = 0.4 * TIMES - 0.8
WALK = np.stack([ALONG, 0.01 * np.abs(np.sin(5 * TIMES)) - 0.3], -1)
TO_AND_FRO = np.stack([0.4 * np.abs((TIMES + 0.7) % 2.6 - 1.3), 0 * TIMES], -1)
FLIGHT = np.stack([0.35 * TIMES - 0.6, 0.5 * TIMES * (3.5 - TIMES) - 0.5], -1)
SPRING = np.stack([0.3 * np.cos(4 * TIMES), 0 * TIMES], -1)
SINKS = np.stack([0.02 * TIMES, 1.0 - 0.4 * TIMES], -1)
SLOWED = np.stack([0.5 * TIMES - 0.055 * TIMES**2, 0 * TIMES], -1)


@pytest.mark.parametrize(
    ("way", "so"),
    [
        (WALK, True),
        (TO_AND_FRO, True),
        (np.stack([ALONG, 0.02 * np.sin(6 * TIMES)], -1), True),
        (np.stack([ALONG, 0.08 * np.sin(6 * TIMES)], -1), False),
        (FLIGHT, False),
        (SPRING, False),
        (SLOWED, False),
        (SINKS, False),
    ],
    ids=["walks", "turns back", "bobs", "winds", "flies", "swings", "gets slower", "sinks"],
)
def test_only_what_keeps_its_line_and_its_speed_passes_by(way, so):
    assert passes_by(noisy(way[:, None], 1e-3), 0) == so


@pytest.mark.parametrize("walk", [WALK, TO_AND_FRO], ids=["walks", "turns back"])
@pytest.mark.parametrize("first", [0, 1])
def test_a_body_is_looked_at_and_not_who_walks_by(walk, first):
    ways = [FLIGHT, walk]
    motion = noisy(np.stack([ways[first], ways[1 - first]], 1), 5e-4)
    looked_at, said = of_lawful_bodies(motion)
    assert looked_at.bodies == 1
    assert np.array_equal(looked_at.positions[..., 0, :], motion.positions[..., first, :])
    assert "1 of them" in said[0]


@pytest.mark.parametrize(
    ("walk", "looked"), [pytest.param(WALK, True, marks=pytest.mark.slow), (TO_AND_FRO, False)]
)
def test_what_only_coasts_is_looked_at_where_nothing_else_moves_by_a_law(walk, looked):
    """But not who turns back: nothing that is seen turns a person round."""
    wave = np.cumsum(np.random.default_rng(2).normal(size=(120, 2)), 0) * 0.03
    looked_at, _ = of_lawful_bodies(noisy(np.stack([wave, walk], 1), 5e-4))
    assert looked_at.bodies == 1
    last = (walk if looked else wave)[-1, 0]
    assert looked_at.positions[0, -1, 0, 0] == pytest.approx(last, abs=0.01)


def test_what_only_jumps_about_is_no_body_though_any_law_leaves_noise():
    jumps = 0.05 * np.random.default_rng(5).normal(size=(120, 2)) + 0.4 * SPRING
    looked_at, _ = of_lawful_bodies(noisy(np.stack([jumps, SPRING - 0.5], 1), 5e-4))
    assert looked_at.bodies == 1
    assert looked_at.positions[0, 0, 0, 0] == pytest.approx(SPRING[0, 0] - 0.5, abs=0.01)


@pytest.mark.parametrize(("share", "bodies"), [(0.55, 1), (0.7, 2)])
def test_what_is_seen_in_few_of_a_bodys_frames_is_a_piece_of_something(share, bodies):
    other = 0.7 * SPRING[::-1] - 0.5
    other[: round((1 - share) * len(other))] = np.nan
    looked_at, _ = of_lawful_bodies(noisy(np.stack([SPRING, other], 1), 5e-4))
    assert looked_at.bodies == bodies


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [0, 1])
def test_where_no_law_moves_any_a_spot_of_noise_is_not_the_body(hidden):
    jolts = np.random.default_rng(1).standard_normal((2, len(TIMES), 2)).cumsum(1) * [[[0.02]]]
    spot = np.where(np.arange(len(TIMES)) % 5 < hidden, np.nan, 0.0)[:, None] * jolts[0]
    motion = noisy(np.stack([spot, *jolts], 1), 1e-4)
    (found,) = of_lawful_bodies(motion)[0].positions[0].transpose(1, 0, 2)
    np.testing.assert_array_equal(found, motion.positions[0, :, 1])


@pytest.mark.parametrize(("share", "body"), [(0.4, 1), (0.7, 0)])
def test_a_hand_that_is_seen_for_a_while_is_not_the_body_that_it_lets_go(share, body):
    slows = np.stack([0.8 * TIMES - 0.2 * TIMES**2, 0 * TIMES], -1)
    hand = np.where(TIMES[:, None] < share * TIMES[-1], slows, np.nan)
    jolts = np.random.default_rng(1).standard_normal((48, 2)).cumsum(0)
    ball = np.concatenate([0.02 * jolts, SPRING[48:]])
    motion = noisy(np.stack([hand, ball], 1), 5e-4)
    looked_at, _ = of_lawful_bodies(motion)
    np.testing.assert_array_equal(looked_at.positions[0, :, 0], motion.positions[0, :, body])


@pytest.mark.slow
@pytest.mark.parametrize(("size", "seen", "bodies"), [(1.0, 1.0, 2), (0.05, 1.0, 1), (1.0, 0.4, 1)])
def test_of_two_that_no_law_moves_alone_both_must_move_and_be_seen(size, seen, bodies):
    jolts = np.random.default_rng(1).standard_normal((2, len(TIMES), 2)).cumsum(1) * 0.02
    jolts[1] *= size
    jolts[1, round(seen * len(TIMES)) :] = np.nan
    motion = noisy(jolts.transpose(1, 0, 2), 1e-4)
    looked_at, _ = of_lawful_bodies(motion)
    assert looked_at.bodies == bodies
    np.testing.assert_array_equal(looked_at.positions[..., 0, :], motion.positions[..., 0, :])
