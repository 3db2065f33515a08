"""A term for which one stretch alone speaks is not told as sure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.inference.doubts import doubts, mistaken
from vidphys.diagnose.inference.menu import FRICTIONS
from vidphys.diagnose.inference.stretches import MANY, of_one_stretch
from vidphys.diagnose.inference.structures import Menu, Structure
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.weak.regression import Rows
from vidphys.experiments.confusion.storms.scenes import LISTED, filmed

WINDOWS, EACH = 8, 40
LINEAR, SQUARE = FRICTIONS["linear"], FRICTIONS["square"]
STEP = 0.05


def asked(share, size=3.0, windows=WINDOWS):
    """What a second term that acts in a share of the windows is said to be."""
    rng = np.random.default_rng(0)
    x = rng.standard_normal((windows * EACH, 2))
    window = np.repeat(np.arange(windows), EACH)
    y = x[:, 0] + size * x[:, 1] * (window < share * windows) + rng.standard_normal(len(x))
    rows = Rows(x, y, np.ones(len(x)), window)

    def fitted(*terms):
        chosen = [(LINEAR, SQUARE).index(term) for term in terms]
        return Structure(terms, np.linalg.lstsq(x[:, chosen], y)[0], 0.0, 0.0)

    structures = fitted(LINEAR, SQUARE), fitted(LINEAR), fitted(SQUARE), fitted()
    return of_one_stretch(Menu((LINEAR, SQUARE)), rows, structures, 0.0)


@pytest.mark.parametrize(("share", "found"), [(1 / WINDOWS, {"square"}), (0.5, set()), (1, set())])
def test_a_kind_that_one_window_asks_for_is_found(share, found):
    assert asked(share) == found


@pytest.mark.parametrize(("windows", "found"), [(MANY, {"square"}), (MANY - 1, set())])
def test_a_moment_may_lie_in_neighbours_where_windows_are_many(windows, found):
    assert asked(4 / windows, windows=windows) == found
    assert asked(6 / windows, windows=windows) == set()


@pytest.mark.parametrize("frames", [40, 100])
def test_a_recording_that_is_one_stretch_is_told_as_sure_as_ever(frames):
    t = STEP * np.arange(frames)
    fall = np.stack([t, 2 * t - 0.5 * 9.81 * t**2], -1)[None, :, None]
    noise = 1e-3 * np.random.default_rng(0).standard_normal(fall.shape)
    found = diagnose_motion(motion_of(fall + noise, STEP))
    assert found.kinds == {"uniform"} and found.told


def test_a_trap_far_away_is_no_motion_without_a_uniform_field():
    found = diagnose_motion(filmed(LISTED["projectile"], "white", 122).motion)
    assert found.kinds == {"uniform"} and found.told


@pytest.mark.slow
def test_a_bath_is_not_sure_where_a_smooth_force_explains_as_much():
    found = diagnose_motion(filmed(LISTED["langevin"], "white", 113).motion)
    assert found.told and "bath" in found.kinds and not doubts(found.motion, found.inference)
    rest = found.inference.leftover
    smooth = replace(found.inference, leftover=replace(rest, smooth_gain=rest.kicks_gain - 1.0))
    assert smooth.stands and not smooth.sure
    assert "random kicks" in doubts(found.motion, smooth)[0]


def test_what_one_stretch_asks_for_and_what_swaps_may_have_left_is_not_told():
    rng = np.random.default_rng(0)
    t = np.arange(200) * STEP
    path = np.stack([np.sin(t), np.cos(t)], -1)[None, :, None]
    found = diagnose_motion(motion_of(path + 1e-3 * rng.standard_normal(path.shape), STEP))
    assert found.told and found.kinds == {"trap"} and not found.inference.alone
    alone = replace(found.inference, alone=frozenset({"trap"}))
    assert alone.stands and not alone.sure
    assert "one stretch alone speaks for trap" in doubts(found.motion, alone)[0]
    swapped = replace(found.inference.leftover, explained=False, probes={"a force": 1e3})
    unknown = replace(found, inference=replace(found.inference, leftover=swapped))
    assert unknown.told
    mended = replace(unknown, mended=replace(unknown.mended, swaps=1))
    assert not mended.told
    assert "a swap of names" in doubts(found.motion, unknown.inference, 1)[0]


def test_what_dry_friction_stops_beside_kicks_may_be_taken_for_a_force_off_the_menu():
    found = SimpleNamespace(kicks=1e-3, kinds={"bath", "dry"})
    assert "dry friction" in mistaken(found, 0) and "swap" in mistaken(found, 1)
    assert not mistaken(SimpleNamespace(kicks=0.0, kinds={"dry"}), 0)
    assert not mistaken(SimpleNamespace(kicks=1e-3, kinds={"bath"}), 0)
