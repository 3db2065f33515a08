import numpy as np
import pytest

from registry import UnknownName
from vidphys.probing.catalogue import TARGETS
from vidphys.probing.coding import coded, decoded
from vidphys.probing.targets import Target, labels_of
from vidphys.probing.truth import Truth

TIMES = np.arange(40) * 0.05


def circling(**more):
    """One body on a circle of radius 2, an angle of 1.5 a second, beside one that rests."""
    phase = 1.5 * TIMES
    first = np.stack([2 * np.cos(phase), 2 * np.sin(phase)], -1)
    return Truth(TIMES, more, np.stack([first, 0 * first], 1))


def test_motion_is_derived_where_only_places_are_known():
    truth, inside = circling(m1=3 + 0 * TIMES, m2=1 + 0 * TIMES), slice(2, -2)
    speed = TARGETS["speed"].read(truth)[inside]
    assert speed[:, 0] == pytest.approx(3.0, rel=2e-3) and np.all(speed[:, 1] == 0)
    acceleration = TARGETS["acceleration"].read(truth)[inside, :2]
    assert np.linalg.norm(acceleration, axis=1) == pytest.approx(4.5, rel=5e-3)
    assert TARGETS["force"].read(truth)[inside, :2] == pytest.approx(3 * acceleration)


def test_a_table_s_own_columns_come_before_derived_ones():
    given = {name: 7 + 0 * TIMES for name in ("vx1", "vy1", "vx2", "vy2")}
    assert np.all(TARGETS["velocity"].read(circling(**given)) == 7)


def test_columns_of_other_bodies_than_have_places_are_not_taken():
    truth = circling(m1=TIMES, vx1=7 + 0 * TIMES, vy1=7 + 0 * TIMES)
    assert np.all(TARGETS["velocity"].read(truth)[:, 2:] == 0)
    with pytest.raises(ValueError, match="columns m of 1 bodies, places of 2"):
        TARGETS["mass"].read(truth)


def test_a_direction_is_known_of_what_moves_alone():
    angle = TARGETS["direction"].read(circling())
    assert np.isnan(angle[:, 1]).all()
    turned = np.exp(1j * (angle[2:-2, 0] - 1.5 * TIMES[2:-2]))
    assert turned == pytest.approx(1j, abs=2e-3)


def test_bodies_touch_within_two_radii():
    places = np.zeros((2, 2, 2))
    places[:, 1, 0] = 0.69, 0.71
    assert TARGETS["contact"].read(Truth(np.arange(2.0), {}, places)).tolist() == [[1], [0]]


def test_any_column_is_a_target():
    truth = Truth(TIMES, {"heat": TIMES, "kind": np.array(["a", "b"] * 20, dtype=object)})
    assert TARGETS["column:heat"].read(truth)[:, 0].tolist() == TIMES.tolist()
    assert TARGETS["class:kind"].kind == "classification"
    assert TARGETS["angle:heat"].kind == "circular"
    with pytest.raises(ValueError, match="no column cold; there are heat, kind"):
        TARGETS["column:cold"].read(truth)
    with pytest.raises(ValueError, match="its values are words, such as a; ask class:kind"):
        TARGETS["column:kind"].read(truth)
    with pytest.raises(UnknownName, match="did you mean 'velocity'"):
        TARGETS["velocty"]


def test_an_unknown_kind_is_refused():
    with pytest.raises(ValueError, match="kind 'ordinal'; use one of regression"):
        Target("x", "ordinal", "frame", lambda truth: truth.times[:, None])


def test_classes_are_numbered_and_gaps_are_not_known():
    raw = np.array([["up"], ["down"], [None], ["up"]], dtype=object)
    labels = labels_of("way", "classification", "frame", raw)
    assert labels.classes == ("down", "up") and labels.known.tolist() == [True, True, False, True]
    share = coded(labels)[labels.known].mean(0)
    assert decoded(labels, coded(labels), share)[labels.known].tolist() == [[1], [0], [1]]
    assert labels_of("n", "classification", "frame", np.array([[10.0], [9.0]])).classes == (
        "9",
        "10",
    )


def test_what_does_not_vary_says_so():
    assert labels_of("x", "regression", "frame", np.ones((4, 2))).why_not.startswith(
        "it is the same"
    )
    assert labels_of("x", "regression", "frame", np.full((4, 1), np.nan)).why_not
    assert not labels_of("x", "circular", "frame", np.array([[0.0], [3.0]])).why_not
