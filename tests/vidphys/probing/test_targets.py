import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from registry import UnknownName
from vidphys.errors import InputError
from vidphys.probing.catalogue import TARGETS
from vidphys.probing.coding import coded, decoded
from vidphys.probing.targets import Target, labels_of
from vidphys.probing.truth import Truth, read_truth

TIMES = np.arange(40) * 0.05


def circling(**more):
    """One body on a circle of radius 2, an angle of 1.5 a second, beside one that rests."""
    phase = 1.5 * TIMES
    places = {"x1": 2 * np.cos(phase), "y1": 2 * np.sin(phase)}
    return Truth(TIMES, {**places, "x2": 0 * TIMES, "y2": 0 * TIMES, **more})


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


def test_a_direction_is_known_of_what_moves_alone():
    angle = TARGETS["direction"].read(circling())
    assert np.isnan(angle[:, 1]).all()
    turned = np.exp(1j * (angle[2:-2, 0] - 1.5 * TIMES[2:-2]))
    assert turned == pytest.approx(1j, abs=2e-3)


def test_bodies_touch_within_two_radii():
    apart = {"x1": np.array([0.0, 0.0]), "x2": np.array([0.69, 0.71])}
    flat = {name: np.zeros(2) for name in ("y1", "y2")}
    assert TARGETS["contact"].read(Truth(np.arange(2.0), {**apart, **flat})).tolist() == [[1], [0]]


def test_any_column_is_a_target():
    truth = Truth(TIMES, {"heat": TIMES, "kind": np.array(["a", "b"] * 20, dtype=object)})
    assert TARGETS["column:heat"].read(truth)[:, 0].tolist() == TIMES.tolist()
    assert TARGETS["class:kind"].kind == "classification"
    assert TARGETS["angle:heat"].kind == "circular"
    with pytest.raises(ValueError, match="no column cold; there are heat, kind"):
        TARGETS["column:cold"].read(truth)
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


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_tables_are_read_by_frame(tmp_path, suffix):
    path = tmp_path / f"clip.{suffix}"
    if suffix == "csv":
        path.write_text("x1,kind\n0.5,a\n,b\n2.5,c\n")
    else:
        pq.write_table(pa.table({"x1": [0.5, None, 2.5], "kind": ["a", "b", "c"]}), path)
    truth = read_truth(path, np.array([1, 2]), np.arange(2.0))
    assert np.isnan(truth.column("x1")[0]) and truth.column("x1")[1] == 2.5
    assert truth.column("kind").tolist() == ["b", "c"]
    with pytest.raises(InputError, match="3 rows, but frame 3 of the clip"):
        read_truth(path, np.array([3]), np.arange(1.0))
