"""Bodies that are not always seen: what is told of the rest, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vidphys.diagnose.test_diagnose import STEP, seen
from vidphys.diagnose import diagnosis
from vidphys.diagnose.diagnosis import nothing_to_see
from vidphys.diagnose.inference.changes import Switch, find_switch
from vidphys.diagnose.inference.search import infer
from vidphys.diagnose.recordings.motion import Unseen, motion_of
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.weak.regression import gram_inverse
from vidphys.diagnose.weak.windows import LEAST, cut_windows
from vidphys.experiments.confusion.scenes import KINDS, Setting, record


def hidden(motion, body, first, stop=None):
    """The same, a body unseen from one frame to another."""
    positions = motion.positions.copy()
    positions[:, first:stop, body] = np.nan
    return replace(motion, positions=positions)


def test_windows_in_which_a_body_is_hardly_seen_are_left_out():
    motion = hidden(seen("gravity"), 1, 0, 20)
    windows = cut_windows(motion, 12)
    assert len(windows) < len(cut_windows(seen("gravity"), 12))
    assert (windows.seen.sum(1) >= LEAST).all()


def test_a_pair_force_is_found_where_one_body_hides_for_a_third_of_the_clips():
    whole, part = seen("gravity", 0.002), hidden(seen("gravity", 0.002), 1, 0, 16)
    assert infer(part).kinds == infer(whole).kinds == {"pair"}


@pytest.mark.slow
def test_bodies_that_are_never_seen_together_are_refused_in_words():
    motion = seen("gravity")
    apart = hidden(hidden(motion, 0, 0, 24), 1, 24)
    with pytest.raises(Unseen, match="follow fewer bodies"):
        cut_windows(apart, 8)
    with pytest.raises(ValueError, match="follow fewer bodies"):
        answer(apart, False, 0.0)


def test_no_switch_is_claimed_where_one_side_of_it_is_not_seen():
    motion = seen("trap", 0.002)
    late = hidden(motion, 0, 0, 40)
    assert find_switch(late, infer(motion)) is None


@pytest.mark.parametrize("first", [16, 19])
def test_a_body_that_crosses_the_picture_is_diagnosed_from_its_frames(first):
    flight = record(KINDS["projectile"], Setting(0.002, STEP, 1, 0), 1, 80)
    crossing = hidden(hidden(flight, 0, 0, first), 0, first + 40)
    found = answer(crossing, False, 0.3)
    assert found.data["terms"] == ["uniform"] and found.data["explained"]
    assert nothing_to_see(hidden(hidden(flight, 0, 0, first), 0, first + 20)) == ""


def test_a_switch_one_side_of_which_shows_too_little_is_none(monkeypatch):
    motion = seen("trap", 0.002)
    late = hidden(motion, slice(None), 0, 24)
    switch = Switch(20, 20 * STEP, 9.0, {}, {})
    monkeypatch.setattr(diagnosis, "find_switch", lambda motion, inference: switch)
    found = diagnosis.diagnose_motion(late)
    assert found.switch is None and found.kinds == {"trap"}


@pytest.mark.parametrize("frame", [8, 9, -9, -8])
def test_a_switch_near_an_end_leaves_each_part_frames_enough(frame):
    motion = seen("trap", 0.002)
    at = frame % motion.positions.shape[1]
    diagnosis._parts(motion, Switch(at, at * STEP, 9.0, {}, {}), angles=False)


def test_tracks_with_hardly_a_frame_in_a_row_are_refused_in_words():
    positions = np.full((1, 40, 1, 2), np.nan)
    positions[:, ::4] = np.random.default_rng(0).standard_normal((1, 10, 1, 2))
    with pytest.raises(ValueError, match="no body is seen in 4 evenly spaced frames"):
        answer(motion_of(positions, STEP), False, 0.0)


def test_a_column_that_is_zero_for_all_that_can_be_told_has_a_finite_inverse():
    gram = np.diag([2.0, 1e-300])
    inverse = gram_inverse(gram)
    assert np.isfinite(inverse).all() and inverse[0, 0] == pytest.approx(0.5)
    assert inverse[1, 1] > 1e12
