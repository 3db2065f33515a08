"""Tables as motions to diagnose, and what is said of those that are none."""

import numpy as np
import pytest

from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.tables import read_tracks
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.weak.mending import mend, without_outliers
from vidphys.errors import InputError

T = np.arange(40) * 0.04


def test_a_table_whose_times_are_not_told_says_how_it_was_read(tmp_path):
    table = tmp_path / "angles.txt"
    table.write_text("".join(f"{np.cos(t):.6f},{t:.3f},{np.sin(3 * t):.6f}\n" for t in T))
    with pytest.raises(InputError, match=r"taken for x, y, z \(y rises as times do\)") as caught:
        read_tracks(table)
    assert "`columns` time=NAME" in str(caught.value) and "\n" not in str(caught.value)
    loaded = read_tracks(table, {"time": "y", "angle[deg]": "x"})
    assert loaded.angles
    np.testing.assert_allclose(loaded.motion.times[0], T, atol=1e-9)
    np.testing.assert_allclose(
        loaded.motion.positions[0, :, 0, 0], np.radians(np.cos(T)), atol=1e-6
    )


def swing(rows):
    """A pendulum's weight in pixels, with a tracker's noise, ``(rows, 2)``."""
    angle = 0.6 * np.cos(3.3 * np.arange(rows) / 30)
    noise = 0.5 * np.random.default_rng(3).normal(size=(rows, 2))
    return np.stack([320 + 280 * np.sin(angle), 60 + 280 * np.cos(angle)], -1) + noise


def written(path, places, names="t,x,y"):
    rows = [",".join(f"{x:.3f}" for x in (k / 30, *row)) for k, row in enumerate(places)]
    path.write_text("\n".join([names, *rows]) + "\n")
    return path


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_number_that_stands_for_not_seen_is_no_place(tmp_path, value):
    places = swing(120)
    gone = [11, 12, 40, 77]
    places[gone] = value
    loaded = read_tracks(written(tmp_path / "swing.csv", places))
    assert np.flatnonzero(~loaded.motion.seen[0, :, 0]).tolist() == gone
    assert f"4 places of {value:g}, far from all others, taken for not seen" in loaded.notes[0]


def test_a_place_at_zero_is_seen_where_a_body_goes_through_it_or_begins_there(tmp_path):
    through = np.round(np.sin(np.arange(120) / 8)[:, None], 1)
    leap = np.concatenate([np.zeros(30), 5 + 0.1 * np.arange(60)])[:, None]
    apart = np.concatenate([5 + 0.1 * np.arange(30), np.zeros(20), 12 + 0.1 * np.arange(30)])
    for places in (through, leap, apart[:, None]):
        loaded = read_tracks(written(tmp_path / "x.csv", places, "t,x"))
        assert loaded.motion.seen.all() and "not seen" not in loaded.notes[0]


def test_frames_that_show_something_else_do_not_hide_a_law():
    places, rng = swing(200), np.random.default_rng(5)
    wrong = rng.choice(200, 6, replace=False)
    places[wrong] = rng.uniform(0, 480, (6, 2))
    given = answer(motion_of(places[None, :, None], 1 / 30), False, 0.3)
    assert given.data["status"] != "not explained" and "pendulum" in given.data["terms"]
    assert given.data["false_finds"] >= 6
    assert "frames of a body fit none of their neighbours and are left out" in given.lines[-1]


def test_only_finds_that_are_far_off_are_left_out_before_laws_are_sought():
    places = swing(200)
    places[60] += 7.5  # far for a tracker, and less than a tenth of the spread
    places[120] += 90.0
    motion = motion_of(places[None, :, None], 1 / 30)
    assert mend(motion).false_finds >= 2
    kept = without_outliers(motion)
    assert np.flatnonzero(~kept.motion.seen[0, :, 0]).tolist() == [120] and kept.false_finds == 1
