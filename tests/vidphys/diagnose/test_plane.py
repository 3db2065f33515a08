"""A table that a camera sees from the side: a rectangle on it tells where on it things are."""

import numpy as np
import pytest

from tests.vidphys.diagnose.test_mechanisms import noisy
from vidphys.diagnose.explanations.verdict import NOT
from vidphys.diagnose.recordings.units import Units, scale_of
from vidphys.diagnose.telling.answers import answer

SIZE = (480, 640)
TABLE = "1.2 x 0.8 m = 190,110 470,120 600,420 40,400"  # its far side is half as wide as the near


def on_it() -> Units:
    return scale_of(TABLE, SIZE)


def corners(units: Units) -> np.ndarray:
    """Of the table, metres, as the plane has them."""
    pixels = np.array([[190, 110], [470, 120], [600, 420], [40, 400]])
    seen = (pixels - [319.5, 239.5]) * [1, -1] / 320
    assert units.plane is not None
    return units.per * units.plane.flat(seen)


def test_the_rectangle_has_its_sides_and_right_angles():
    found = corners(on_it())
    ways = np.roll(found, -1, 0) - found
    assert np.linalg.norm(ways, axis=1) == pytest.approx([1.2, 0.8, 1.2, 0.8])
    assert ways[0] @ ways[1] == pytest.approx(0, abs=1e-12)


def test_the_plane_lies_as_the_picture_does():
    """To the right and upwards stay so, and nothing is mirrored; the middle is the table's."""
    assert corners(on_it()).mean(0) == pytest.approx(np.zeros(2), abs=1e-12)
    left, right, near, _ = corners(on_it())
    assert right[0] - left[0] > 1.1 and near[1] < right[1] - 0.7


def test_places_go_there_and_back():
    plane, places = on_it().plane, np.random.default_rng(0).uniform(-0.7, 0.7, (30, 2, 2))
    assert plane is not None
    assert plane.shown(plane.flat(places)) == pytest.approx(places, abs=1e-12)


def test_what_is_seen_beyond_the_horizon_is_not_on_the_table():
    """A head behind it: the table's plane ends 1.3 half widths above the picture's middle."""
    plane = on_it().plane
    assert plane is not None
    assert np.isfinite(plane.flat(np.array([0.0, 1.2]))).all()
    assert np.isnan(plane.flat(np.array([0.0, 1.4]))).all()


@pytest.mark.parametrize("turned", [1, 2, 3])
def test_it_does_not_matter_at_which_corner_one_begins(turned):
    """The other way round too."""
    sides, pixels = TABLE.split(" m = ")
    order = np.roll(pixels.split(), turned)[::-1].tolist()
    swapped = " x ".join(reversed(sides.split(" x "))) if turned % 2 else sides
    # a first side between the second and the third corner is the other one
    other = scale_of(f"{swapped} m = {' '.join(order)}", SIZE)
    shown = np.random.default_rng(1).uniform(-0.5, 0.5, (9, 2))
    assert other.plane is not None and on_it().plane is not None
    assert other.per * other.plane.flat(shown) == pytest.approx(
        on_it().per * on_it().plane.flat(shown)
    )


def test_what_slides_on_a_table_is_told_in_metres():
    units, times = on_it(), np.arange(60) / 30
    assert units.plane is not None
    speed, slows = 0.83, 0.55
    way = np.where(
        times < speed / slows, speed * times - slows * times**2 / 2, speed**2 / slows / 2
    )
    start, along = np.array([-0.3, 0.25]), np.array([0.8, -0.6])
    places = (start + way[:, None] * along) / units.per
    seen = noisy(units.plane.shown(places), 0.0005, 1 / 30)
    flat = noisy(units.plane.flat(seen.positions[0]), 0.0, 1 / 30)
    given = answer(flat, False, 0.3, camera=True, units=units)
    assert given.data["terms"] == ["dry"] and given.data["status"] != NOT
    told = given.data["mechanism"][0]["quantities"]["dry friction"]
    assert told["value"] == pytest.approx(slows, rel=0.03) and told["unit"] == "m/s²"
    drawn = given.showcase(np.zeros((60, *SIZE, 3), np.uint8))
    assert drawn is not None  # over the picture, where the camera saw it
    assert drawn["readout"][:, 0] == pytest.approx(seen.positions[0, :, 0], abs=1e-9)


@pytest.mark.parametrize(
    "pixels", ["0,0 9,0 9,9", "0,0 9,9 9,0 0,9", "0,0 5,0 9,0 0,9", "0,0 9,0 9,0 0,9"]
)
def test_corners_that_bound_no_rectangle_are_refused(pixels):
    with pytest.raises(ValueError, match="write LENGTH|in order round|must be above 0"):
        scale_of(f"2 x 1 m = {pixels}", SIZE)
