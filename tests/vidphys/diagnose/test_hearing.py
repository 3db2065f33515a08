"""Rival terms are judged along the paths that they give themselves."""

from dataclasses import replace

import numpy as np
import pytest

from vidphys.diagnose.diagnosis import diagnose_motion
from vidphys.diagnose.inference.doubts import doubts
from vidphys.diagnose.inference.hearing import Heard, heard, key_of, reweighed
from vidphys.diagnose.inference.menu import field_of, pair_term
from vidphys.diagnose.inference.structures import Structure, price
from vidphys.diagnose.weak.paths import integrated, smooth
from vidphys.diagnose.weak.windows import cut_windows
from vidphys.experiments.confusion.storms.scenes import LISTED, filmed

SIGMA, FLOOR = 1e-3, 1e-5


@pytest.fixture(scope="module")
def gravity():
    return filmed(LISTED["gravity"], "drop-outs", 113).motion


def pair(shape, length, strength=0.7):
    return Structure((pair_term(shape, length, "mass"),), np.array([strength]), 0.0, 0.0)


def along(windows, structure):
    """Paths that a structure gives, whether it is right or not."""
    paths = smooth(windows, SIGMA)
    for _ in range(4):
        paths = integrated(windows, structure.accelerations(field_of(windows, paths)))
    return paths


@pytest.mark.parametrize("frames", [16, 9])  # of 31 windows, and of more, heard by parts first
def test_the_right_shape_wins_along_the_paths_of_a_wrong_one(gravity, frames):
    windows = cut_windows(gravity, frames)
    wrong = pair("inverse-cube", 0.6)
    fits = heard(windows, along(windows, wrong), [wrong, pair("inverse-square", 0.3)], 0.0, FLOOR)
    assert fits[0].key == (frozenset({"pair"}), "inverse-square")
    assert fits[0].fitted.variance ** 0.5 == pytest.approx(SIGMA, rel=0.1)
    assert all(first.score >= then.score for first, then in zip(fits, fits[1:], strict=False))


def test_a_term_whose_number_has_the_wrong_sign_is_not_heard(gravity):
    windows = cut_windows(gravity, 16)
    paths = smooth(windows, SIGMA)
    assert heard(windows, paths, [pair("inverse-square", 0.3)], 0.0, FLOOR)
    assert not heard(windows, paths, [pair("contact", 1.5)], 0.0, FLOOR)  # they attract


@pytest.mark.parametrize(("behind", "count"), [(300.0, 2), (1e3, 1)])  # of 700 coordinates
def test_what_is_hopelessly_behind_is_not_heard(gravity, behind, count):
    windows = cut_windows(gravity, 16).only(np.arange(8))
    right, rival = pair("inverse-square", 0.3), replace(pair("inverse-cube", 0.6), score=-behind)
    assert len(heard(windows, smooth(windows, SIGMA), [right, rival], 0.0, FLOOR)) == count


def test_scores_of_those_heard_move_and_others_stay():
    wrong, right, none = pair("inverse-cube", 0.6), pair("inverse-square", 0.3), pair("spring", 1.0)
    ranked = [replace(s, score=x) for s, x in ((wrong, 5.0), (none, 2.0), (right, 1.0))]
    again = reweighed(ranked, [Heard(70.0, key_of(right), None), Heard(50.0, key_of(wrong), None)])
    found = [(s.terms[0].shape, s.score) for s in again]
    assert found == [("spring", 2.0), ("inverse-square", 1.0), ("inverse-cube", -19.0)]
    assert reweighed(ranked[:1], [Heard(70.0, key_of(right), None)]) == ranked[:1]


def test_a_wrong_shape_that_led_along_its_own_paths_is_not_told(gravity):
    found = diagnose_motion(gravity)
    assert found.told and found.kinds == {"pair"}
    assert found.inference.structure.term("pair").shape == "inverse-square"


@pytest.mark.parametrize(("gain", "sure"), [(5.0, True), (9.0, False)])  # chances 2e-2 and 4e-4
def test_a_term_that_explains_more_than_chance_is_not_told_as_absent(gravity, gain, sure):
    found = diagnose_motion(gravity).inference
    best, other = found.structures[0], next(x for x in found.structures if "trap" in x.kinds)
    trapped = replace(other, terms=(*best.terms, other.term("external")))
    assert trapped.numbers == best.numbers + 3  # chances by chi-square of three numbers
    score = best.score + gain - price(found.fitted.freedom, 3)
    also = replace(found, structures=(best, replace(trapped, score=score)))
    assert also.stands and also.sure == sure and also.slight == (frozenset() if sure else {"trap"})
    told = [said for said in doubts(gravity, also) if "trap may be there too" in said]
    assert len(told) == (not sure)
