"""Bodies that are held when a recording begins: noticed, left out, and not seen where none is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.vidphys.stress.test_flights import STEP, TRUE, stepped
from vidphys.diagnose.mechanisms import mechanism
from vidphys.diagnose.mechanisms.bodies.lawful import of_lawful_bodies
from vidphys.diagnose.mechanisms.mechanism import find_mechanism, first_lawful, lawful_from
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.parted import parted
from vidphys.diagnose.recordings.release import free_frames, held_until, held_within
from vidphys.diagnose.telling.answers import answer

FRAMES = 120
NOISE = 0.001


def recorded(path, noise=NOISE, seed=0):
    """A body along a path ``(t, d)``, as it is seen."""
    path = path + noise * np.random.default_rng(seed).standard_normal(path.shape)
    return motion_of(path[None, :, None], STEP)


def falling(held, pull):
    t = np.maximum(np.arange(FRAMES) - held, 0) * STEP
    return np.stack([0 * t, 0.5 * pull * t**2], -1)


@settings(max_examples=30, deadline=None)
@given(st.integers(20, 60), st.floats(0.5, 5.0), st.integers(0, 2**31))
def test_a_release_is_found_as_soon_as_it_shows(held, pull, seed):
    shows = int(np.ceil(np.sqrt(2 * 8 * NOISE / pull) / STEP))
    assert held <= held_until(recorded(falling(held, pull), seed=seed)) <= held + shows


@settings(max_examples=30, deadline=None)
@given(st.floats(0.02, 5.0), st.floats(0.0, 6.0), st.integers(0, 2**31))
def test_a_body_that_starts_from_rest_was_not_held(pull, stiffness, seed):
    t = np.arange(FRAMES) * STEP
    fall = falling(0, pull)
    swing = np.stack([0 * t, pull * np.cos(stiffness * t)], -1)
    assert held_until(recorded(fall, seed=seed)) == 0
    assert held_until(recorded(swing, seed=seed)) == 0


def test_a_body_is_held_also_if_it_swings_back_later():
    since = np.maximum(np.arange(FRAMES) - 30, 0) * STEP
    swing = np.stack([0 * since, np.cos(2 * np.pi * since / (30 * STEP))], -1)
    assert 30 < held_until(recorded(swing)) <= 32


def test_moving_or_unseen_or_resting_bodies_are_not_held():
    t = np.arange(FRAMES)[:, None] * STEP
    moving = recorded(np.concatenate([t, 0.2 * t], 1))
    assert held_until(moving) == 0
    resting = recorded(np.zeros((FRAMES, 2)))
    assert held_until(resting) == 0
    hidden = recorded(falling(30, 2.0)).positions
    hidden[:, :10] = np.nan
    assert held_until(motion_of(hidden, STEP)) == 0


def test_one_moving_body_is_enough_to_see_that_none_is_held():
    both = np.stack([falling(30, 2.0), falling(0, 2.0)], 1)
    assert held_until(motion_of(both[None], STEP)) == 0


def test_a_hold_is_counted_from_where_the_body_is_first_seen():
    whole = recorded(falling(30, 2.0))
    first, stop = free_frames(whole)
    path = np.pad(whole.positions, ((0, 0), (7, 5), (0, 0), (0, 0)), constant_values=np.nan)
    assert first >= 30 and free_frames(motion_of(path, STEP)) == (first + 7, stop + 7)


def test_a_flight_that_is_seen_only_at_its_end_is_told_though_its_beginning_shows_too_little():
    """As of a ball that was lost where a hand threw it."""
    t = np.arange(26) * STEP
    path = np.stack([3.0 * t, 4.0 * t - 4.9 * t**2], -1)
    path[:5] = path[5] + 0.05 * np.random.default_rng(1).normal(size=(5, 2))
    path[5:14] = np.nan
    told = answer(recorded(path, 1e-4), False, 0.4)
    assert told.data["terms"] == ["uniform"]
    given = told.data["mechanism"][0]["quantities"]["acceleration"]
    assert given["value"] == pytest.approx(9.8, rel=0.1)


@pytest.fixture(scope="module")
def held_answer():
    """A swing beside a wall that a hand lets go after twelve frames."""
    s = stepped(TRUE, np.arange(240) * STEP)
    s = np.concatenate([np.full(12, s[0]), s])
    path = np.stack([s, 0.3 * s**2 - 0.6], -1)
    return answer(recorded(path, 0.002), False, 0.3)


def test_a_wall_is_found_although_a_hand_held_the_body_at_first(held_answer):
    held = held_answer.data["held_until"]
    assert 12 <= held["frame"] <= 16 and held["time"] == pytest.approx(held["frame"] * STEP)
    assert f"something holds the body until {held['frame'] - 1}" in held_answer.lines[0]
    assert held_answer.lines[0].startswith(f"Frames {held['frame']} to 251 of 252 are used: ")
    assert held_answer.data["terms"] == ["linear", "pendulum", "wall"]  # its path is an arc
    found = held_answer.data["mechanism"][0]["quantities"]
    assert found["restitution"]["value"] == pytest.approx(TRUE.restitution, abs=0.03)
    assert held_answer.numbers["forecast_rmse_model"] < 0.02


def test_the_frames_of_a_hold_are_still_shown(held_answer):
    assert len(held_answer.times) == len(held_answer.positions) == 252
    model, _ = held_answer.rolled["model"]
    assert model[-1] == held_answer.times[-1]


def test_a_wall_is_said_and_no_heat_bath(held_answer):
    said = "\n".join(held_answer.lines)
    assert "it bounces off a wall" in said and "bath" not in said


def caught(stop, again, frames=FRAMES):
    """A swing that something stops where it is, holds, and lets go at frame ``again``."""
    t = np.arange(frames) * STEP
    s = np.cos(3.0 * t)
    s[stop:again] = s[stop]
    s[again:] = s[stop] * np.cos(3.0 * (t[again:] - t[again]))
    return np.stack([0.2 * s, s], -1)


@pytest.mark.parametrize("stop, again, longest", [(20, 45, (45, FRAMES)), (72, 95, (0, 72))])
def test_a_hold_in_the_middle_is_left_out_with_the_shorter_part(stop, again, longest):
    swing = recorded(caught(stop, again))
    (start, free), *more = held_within(swing)
    assert not more and abs(start - stop) <= 2 and 0 <= free - again <= 5
    assert np.allclose(free_frames(swing), longest, atol=5)
    begin, end = free_frames(swing)
    said = answer(swing, False, 0.3).lines[0]
    assert said.startswith(f"Frames {begin} to {end - 1} of {FRAMES} are used: something holds")
    assert said.endswith(f"until {begin - 1}." if begin else f"from {end} on.")


@settings(max_examples=30, deadline=None)
@given(st.floats(0.5, 6.0), st.floats(0.05, 1.0), st.integers(0, 2**31))
def test_a_swing_that_turns_slowly_or_comes_to_rest_is_not_held(rate, damping, seed):
    t = np.arange(3 * FRAMES) * STEP
    swing = np.exp(-damping * t) * np.cos(rate * t)
    assert held_within(recorded(np.stack([swing, 0.1 * swing**2], -1), seed=seed)) == []


def carried_and_thrown(frames, loose=20, pull=9.0):
    """A body that a hand swings about and throws at a frame; nothing is ever held still."""
    times = np.arange(frames) / 30
    free, bound = np.maximum(times - loose / 30, 0), np.minimum(times, loose / 30)
    hand = 0.1 * np.stack([np.sin(9 * bound), 1.5 * np.cos(7 * bound)], -1)
    path = hand + np.stack([0.9 * free, 2.2 * free - 0.5 * pull * free**2], -1)
    noise = 5e-4 * np.random.default_rng(4).standard_normal(path.shape)
    return motion_of((path + noise)[None, :, None], 1 / 30)


@pytest.mark.slow
@pytest.mark.parametrize(("frames", "enough"), [(42, True), (35, False)])
def test_of_what_a_hand_throws_the_tail_is_a_share_of_the_flight(frames, enough):
    given = answer(carried_and_thrown(frames), False, 0.4, camera=True)
    assert given.data["terms"] == ["uniform"] and given.data["status"] == "mostly explained"
    assert given.data["frames"]["first"] in range(20, 24)
    assert "one law holds from" in given.lines[0]
    assert ("model" in given.rolled) is enough  # to hold some out
    found = given.data["mechanism"][0]["quantities"]["acceleration"]
    assert abs(found["value"] - 9.0) < 2 * found["standard_error"]


def thrown(frames=46, loose=26, still=20):
    """A ball that rests in a hand, is pushed, and flies; and the hand, which stays near at first.

    Returns:
        Places ``(t, 2, 2)``.
    """
    times = np.arange(frames) / 30
    pushed = np.clip(times - still / 30, 0, (loose - still) / 30)
    free = np.maximum(times - loose / 30, 0)
    hand = 0.5 * 14.0 * pushed[:, None] ** 2 * [0.4, 1.0]
    fast = 14.0 * (loose - still) / 30 * np.array([0.4, 1.0])
    ball = hand + free[:, None] * fast - 0.5 * 9.0 * free[:, None] ** 2 * [0.0, 1.0]
    near = 0.04 - 0.2 * pushed[:, None]  # its middle, when it pushes
    shakes = 0.02 * np.stack([np.sin(23 * free) * np.cos(9 * free), np.cos(31 * free) - 1], -1)
    shakes = shakes * np.exp(-6 * free)[:, None]
    hand = hand + 0.1 * (1 - np.exp(-9 * free))[:, None] * fast + shakes - near * [0.4, 1.0]
    noise = 5e-4 * np.random.default_rng(4).standard_normal((frames, 2, 2))
    return np.stack([ball, hand], 1) + noise


def test_a_ball_keeps_the_frames_in_which_it_leaves_the_hand():
    both = thrown()
    both[:24, 0] = np.nan  # the hand hides it
    motion = motion_of(both[None], 1 / 30)
    kept, _ = of_lawful_bodies(motion)
    assert not parted(motion).seen[0, 24:27].any()
    assert kept.bodies == 1 and kept.seen[0, 24:].all()


def test_a_ball_that_the_hand_hides_at_first_is_told_from_one_that_comes_to_rest():
    times = np.arange(34) / 30
    free, held = np.maximum(times - 0.65, 0), np.minimum(times, 0.65)
    way = np.stack([0.2 * held, 3.0 * (held - 0.3) ** 3], -1)
    ball = way + np.stack([0.2 * free, 1.1 * free - 4.0 * free**2], -1)
    hand = [-0.3, -0.6] + [0.04, 0.4] * (1 - np.exp(-8 * (times - 0.45)))[:, None]
    ball[:11], hand[:14] = np.nan, np.nan
    both = np.stack([ball, hand], 1)
    both += 5e-4 * np.random.default_rng(5).standard_normal(both.shape)
    kept, _ = of_lawful_bodies(motion_of(both[None], 1 / 30))
    np.testing.assert_allclose(kept.positions[0, 20:, 0], ball[20:], atol=3e-3)


def test_the_law_of_what_is_thrown_begins_where_the_hand_lets_go():
    ball = motion_of(thrown()[None, 20:, :1], 1 / 30)
    found = find_mechanism(ball.cut(0, 18), camera=True)
    assert found.kinds == {"uniform"} and 5 <= found.first <= 7


@pytest.mark.parametrize("frames", [10, 12, 15])
def test_of_a_short_clip_only_frames_that_leave_enough_are_tried(frames):
    path = np.random.default_rng(0).standard_normal((frames, 2)).cumsum(0)
    assert first_lawful(motion_of(path[None, :, None], 1 / 30), angles=False) <= frames - 10


def test_whether_a_law_holds_later_is_told_by_the_latest_frame_that_shows_it(monkeypatch):
    motion, tried, roughly = motion_of(thrown()[None, 20:, :1], 1 / 30), [], mechanism.roughly
    monkeypatch.setattr(mechanism, "roughly", lambda *x: tried.append(x) or roughly(*x))
    assert next(lawful_from(motion, angles=False), None) is not None
    assert len(tried) == 1
    assert first_lawful(motion, angles=False) > 0


def test_where_no_law_holds_for_the_last_frames_none_is_tried_on_more(monkeypatch):
    times, tried, roughly = np.arange(120) / 30, [], mechanism.roughly
    pulled = np.stack([np.cos(times) + 0.4 * np.cos(5.1 * times), np.sin(2.3 * times)], -1)
    monkeypatch.setattr(mechanism, "roughly", lambda *x: tried.append(x) or roughly(*x))
    assert first_lawful(motion_of(pulled[None, :, None], 1 / 30), angles=False) == 0
    assert len(tried) == 1


@pytest.mark.parametrize("unseen", [slice(2, None), slice(7, None), slice(9, None), slice(-5)])
def test_a_short_clip_with_what_is_hardly_seen_has_a_body(unseen):
    g, t = np.random.default_rng(3), np.arange(16) / 25
    jumpy = np.array([0.1, 0.0]) + 0.04 * g.standard_normal((16, 2)).cumsum(0)
    other = np.array([-0.4, 0.2]) + 0.05 * g.standard_normal((16, 2))
    brief = np.stack([0.2 + 0.1 * t, 0.3 - 0.2 * t], -1)
    brief[unseen] = np.nan
    path = np.stack([jumpy, other, brief], 1)
    motion, _ = of_lawful_bodies(motion_of(path[None], 1 / 25))
    assert motion.bodies >= 1 and motion.positions.shape[1] == 16


@pytest.mark.slow
def test_what_moves_in_its_first_frames_and_then_stays_is_no_body_beside_one_that_goes_on():
    g, t = np.random.default_rng(5), np.arange(26) / 25
    pulled = np.stack([-0.7 + 0.2 * t + 1.3 * t**2, 0.2 + 0 * t], -1)
    leaves = np.full((26, 2), [-0.9, 0.13])
    leaves[:7], leaves[7], leaves[8] = np.nan, [-0.9, 0.6], [-0.9, 0.36]
    path = np.stack([pulled, leaves], 1) + 5e-4 * g.standard_normal((26, 2, 2))
    motion, said = of_lawful_bodies(motion_of(path[None], 1 / 25))
    np.testing.assert_allclose(motion.positions[0, 9:, 0], path[9:, 0])
    assert motion.bodies == 1 and "2 things move" in said[0]


def test_what_comes_into_view_in_the_last_frames_alone_was_not_let_go():
    g, t = np.random.default_rng(11), np.arange(30) / 25
    late = np.stack([0.5 * t, 0.3 - 2 * t**2], -1) + 0.02 * g.standard_normal((30, 2))
    late[:25] = np.nan
    path = np.stack([late, 0.05 * g.standard_normal((30, 2)).cumsum(0)], 1)
    motion, _ = of_lawful_bodies(motion_of(path[None], 1 / 25))
    np.testing.assert_allclose(motion.positions[0, :, -1], path[:, 1])
