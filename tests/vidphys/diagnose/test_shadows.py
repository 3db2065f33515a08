"""What moves in proportion to a body is its shadow, unless it is another body made alike."""

import numpy as np
import pytest

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies

TIMES = np.arange(120) / 30


def pendulum(swing: float, length: float, pivot: float) -> np.ndarray:
    """Places ``(t, 2)``, y up, that pass their middle many times."""
    angle = swing * np.cos((9.81 / length) ** 0.5 * TIMES)
    return np.stack([pivot + length * np.sin(angle), 0.5 - length * np.cos(angle)], -1)


def looked_at(*ways: np.ndarray) -> tuple[int, str]:
    motion, said = of_lawful_bodies(noisy(np.stack(ways, 1), 3e-4))
    return motion.bodies, " ".join(said)


def test_a_shadow_on_the_floor_is_left_out_and_said():
    weight = pendulum(0.4, 0.8, 0.0)
    shadow = np.stack([0.1 + 0.85 * weight[:, 0], np.full(len(TIMES), -0.6)], -1)
    bodies, said = looked_at(weight, shadow)
    assert bodies == 1
    assert "thing 2 moves in proportion to thing 1, as its shadow" in said
    assert "thing 1 moves in proportion to thing 2, as its shadow" in looked_at(shadow, weight)[1]


def test_a_shadow_that_swings_wider_where_it_comes_nearer_to_the_camera_is_one():
    weight = pendulum(1.3, 0.8, 0.0)
    nearer = 1 / (1 + 0.6 * (weight[:, 1] - weight[:, 1].min()))
    shadow = np.stack([0.1 + 0.85 * nearer * weight[:, 0], -1 + 0.25 * nearer], -1)
    assert "thing 2 moves in proportion to thing 1" in looked_at(weight, shadow)[1]


def test_a_shadow_that_a_foot_hides_in_part_each_time_it_passes_there_is_one():
    weight = pendulum(0.4, 0.8, 0.0)
    x = 0.1 + 0.85 * weight[:, 0]
    hidden = np.abs(x - 0.02) < 0.03  # its visible rest lies aside
    x = np.where(hidden, x - 0.04, x)
    shadow = np.stack([x, np.full(len(TIMES), -0.6)], -1)
    assert "thing 2 moves in proportion to thing 1" in looked_at(weight, shadow)[1]


def test_a_piece_of_the_string_is_not_the_body_though_it_is_above():
    weight = pendulum(0.4, 0.8, 0.0)
    piece = np.array([0.0, 0.5]) + 0.6 * (weight - [0.0, 0.5])
    assert "thing 2 moves in proportion to thing 1" in looked_at(weight, piece)[1]


def test_a_piece_just_above_the_weight_is_not_the_body_where_it_is_followed_less_surely():
    weight, pivot = pendulum(0.4, 0.8, 0.0), np.array([0.0, 0.5])
    rng = np.random.default_rng(0)
    unsure = 1e-3 * rng.standard_normal(weight.shape)
    piece = pivot + 0.85 * (weight - pivot)
    assert "thing 2 moves in proportion to thing 1" in looked_at(weight, piece + unsure)[1]
    # of two that are followed as surely, or that do not hang one by the other, the upper one is
    assert "thing 1 moves in proportion to thing 2" in looked_at(weight, piece)[1]
    aside = piece + unsure + [0.2, 0.0]
    assert "thing 1 moves in proportion to thing 2" in looked_at(weight, aside)[1]


@pytest.mark.parametrize("longer", [1.0, pytest.param(1.1, marks=pytest.mark.slow)])
def test_a_pendulum_that_swings_beside_another_is_no_shadow(longer):
    bodies, said = looked_at(pendulum(0.4, 0.5, -0.4), pendulum(0.4, 0.5 * longer, 0.4))
    assert bodies == 2 and not said


def test_two_that_swing_against_each_other_are_no_shadows():
    right = np.stack([0.3 + 0.05 * np.cos(7 * TIMES), 0 * TIMES], -1)
    bodies, said = looked_at(right, right * [-0.8, 1.0])
    assert bodies == 2 and not said


def test_what_a_floor_mirrors_is_no_body():
    above = np.stack([0.02 * TIMES, 0.3 + 0.05 * np.cos(7 * TIMES)], -1)
    assert "thing 2 moves in proportion" in looked_at(above, above * [1.0, -0.9])[1]


def test_the_wheels_of_a_cart_are_one_body():
    cart = np.stack([0.5 * np.cos(5 * TIMES), 0 * TIMES], -1)
    bodies, said = looked_at(cart - [0.05, 0.1], cart + [0.05, -0.1])
    assert bodies == 1
    assert "thing 2 goes with thing 1 wherever it goes, as a part of it does" in said


def test_a_hook_that_is_lost_now_and_then_is_part_of_its_weight_though_it_is_above():
    weight = pendulum(0.4, 0.8, 0.0)
    hook = weight + [0.0, 0.08]
    hook[::16] = np.nan
    assert "thing 1 goes with thing 2" in looked_at(hook, weight)[1]
    assert "thing 2 goes with thing 1" in looked_at(weight, hook)[1]


def test_two_that_coast_are_no_shadows_though_both_go_straight():
    ways = [np.stack([speed * TIMES - 0.6, 0 * TIMES + speed], -1) for speed in (0.3, 0.2)]
    assert "proportion" not in looked_at(*ways)[1]


def tossed(sideways: float, size: float = 1.0, up: float = 4.0) -> np.ndarray:
    """Places of one flight up and down, and where they are first, from as far away as it takes."""
    free = TIMES[:25]
    return size * np.stack([sideways * free - 0.3, up * free - 4.9 * free**2 - 0.5], -1)


@pytest.mark.parametrize("sideways", [0.5, -0.4])
def test_the_shadow_of_a_tossed_ball_is_left_out(sideways):
    ball = tossed(sideways)
    bodies, said = looked_at(ball, tossed(sideways, 0.7) + [0.1, -0.3])
    assert bodies == 1 and "thing 2 moves in proportion to thing 1" in said


@pytest.mark.parametrize("frames", [25, 14])
def test_the_shadow_of_a_tossed_ball_on_a_floor_is_left_out(frames):
    """Light falls aslant, and the floor is seen in perspective; also while the ball still rises."""
    ball = tossed(1.5)[:frames]
    nearer = 1 / (1 + 0.15 * (ball[:, 1] + 0.5))
    shadow = np.stack([0.2 + nearer * (ball[:, 0] + 0.3 * ball[:, 1]), -0.9 * nearer - 0.1], -1)
    assert "thing 2 moves in proportion to thing 1" in looked_at(ball, shadow)[1]


def test_the_shadow_of_a_tossed_ball_on_a_wall_is_left_out():
    """Light comes from above and the side: it goes less far up and down than the ball."""
    ball = tossed(0.9)
    shadow = np.stack([0.1 + 0.9 * ball[:, 0] - 0.2 * ball[:, 1], -0.9 + 0.5 * ball[:, 1]], -1)
    assert "thing 2 moves in proportion to thing 1" in looked_at(ball, shadow)[1]


def test_two_that_meet_are_no_shadows_though_each_turns_when_the_other_does():
    since = TIMES[:40] - TIMES[20]
    turned = np.maximum(since, 0)
    upper = np.stack([0.5 * since, -0.6 * turned], -1)
    lower = np.stack([0.4 * since, -0.3 + 0.15 * turned - 0.4 * since], -1)
    assert "proportion" not in looked_at(upper, lower - [0.0, 1.2])[1]


@pytest.mark.parametrize(
    "other",
    [tossed(0.3), tossed(0.1, 0.7), tossed(-0.5, 0.7), tossed(0.5, 1.0), tossed(0.5, 0.7, 3.0)],
)
def test_what_is_tossed_at_the_same_time_is_no_shadow(other):
    """Thrown otherwise sideways, also from farther away; thrown alike; and not as high."""
    assert "proportion" not in looked_at(tossed(0.5), other + [0.2, -0.1])[1]


def test_two_that_fall_straight_down_at_once_are_no_shadows():
    assert "proportion" not in looked_at(tossed(0.0), tossed(0.0, 0.7) + [0.2, -0.1])[1]


def test_what_is_seen_at_other_times_is_no_shadow():
    weight = pendulum(0.4, 0.5, -0.3)
    other = 0.8 * weight
    weight[60:], other[:60] = np.nan, np.nan
    assert "proportion" not in looked_at(weight, other)[1]


@pytest.mark.parametrize(("bend", "kept"), [(0.3, 2), pytest.param(0.6, 3, marks=pytest.mark.slow)])
def test_a_shadow_that_a_lens_bends_is_no_second_rod_and_hides_no_other_pendulum(bend, kept):
    weight, other = pendulum(0.3, 0.38, -0.37), pendulum(0.3, 0.75, 0.2)
    away = weight[:, 0] + 0.37
    shadow = np.stack([-0.16 + 0.7 * away + bend * away**2, np.full(len(TIMES), -0.35)], -1)
    motion = noisy(np.stack([weight, other, shadow], 1), 1e-3)
    found, _ = of_lawful_bodies(motion)
    np.testing.assert_array_equal(found.positions, motion.positions[:, :, :kept])
