"""Frames that come twice, pauses, and frames that are missing: found, and not invented."""

import numpy as np
import pytest

from binders.motion import MotionBinder
from binders.wanted import Wanted
from vidphys.data.rendered import write_video
from vidphys.data.video import ClipSelection
from vidphys.diagnose.recordings.broken import mend
from vidphys.diagnose.recordings.clips import follow_clip
from vidphys.diagnose.recordings.used import Used

STEP, COUNT, SIDE = 1 / 30, 80, 96
NOISE = 0.1  # pixels


def swing(count=COUNT):
    t = np.arange(count) * STEP
    return np.stack([48 + 34 * np.cos(4 * t), 40 - 8 * np.cos(8 * t)], -1)


def fall_and_bounce(late=0.5):
    """A ball that is thrown up and strikes the floor between two frames, thrice."""
    places, x, v = [], 20.0, 0.0
    for _ in range(COUNT):
        places.append(x)
        x, v = x + v + late, v + 1.0
        if x > 80:
            x, v = 160 - x, -0.9 * v
    return np.stack([10 + 0.2 * np.arange(COUNT), np.array(places)], -1)


def drawn(path, seed=0):
    """Frames of a disc, with new noise in each."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:SIDE, :SIDE]
    away = np.hypot(x - path[:, 0, None, None], y - path[:, 1, None, None])
    grey = 60 + 150 * np.clip(6.5 - away, 0, 1) + rng.standard_normal(away.shape)
    return np.repeat(grey[..., None], 3, -1).astype(np.uint8)


def mended(path, shown, times=None, seed=0):
    """What is made of pictures of a path, of which the frames ``shown`` are shown."""
    seen = path + NOISE * np.random.default_rng(seed).standard_normal(path.shape)
    times = np.arange(len(shown)) * STEP if times is None else times
    return mend(seen[shown][:, None], times, drawn(path)[shown])


@pytest.mark.parametrize("path", [swing(), fall_and_bounce()])
def test_nothing_is_wrong_with_a_whole_recording(path):
    found = mended(path, np.arange(COUNT))
    assert not (found.doubled or found.paused or found.missing)
    assert np.isfinite(found.positions).all()


def test_a_doubled_frame_is_left_out_and_keeps_its_time():
    shown = np.arange(COUNT)
    shown[[11, 30, 31, 57]] = 10, 29, 29, 56
    found = mended(swing(), shown)
    assert found.doubled == (11, 30, 31, 57) and not (found.paused or found.missing)
    assert np.flatnonzero(np.isnan(found.positions[:, 0, 0])).tolist() == [11, 30, 31, 57]
    np.testing.assert_array_equal(found.times, np.arange(COUNT) * STEP)


def test_a_body_that_comes_back_to_its_place_was_not_shown_again():
    """It is where it was a frame ago as it strikes the floor, but in a new picture."""
    path = swing()
    path[30:] -= path[30] - path[29]  # as tracks may have it
    seen = path[:, None]
    assert mend(seen, np.arange(COUNT) * STEP, drawn(swing())).doubled == ()
    down = np.abs(np.arange(COUNT) - 40.5)[:, None] * np.array([0.0, 2.0])
    assert mended(80 - down, np.arange(COUNT)).doubled == ()


@pytest.mark.parametrize("stops", [True, False])
def test_the_clock_stops_in_a_pause_and_not_where_pictures_stutter(stops):
    still = np.full(12, 30)
    shown = np.concatenate([np.arange(31), still, np.arange(31 if stops else 43, COUNT)])
    found = mended(swing(), shown)
    assert found.paused == tuple(range(31, 43)) and not found.doubled
    assert (np.diff(found.times) > 0).all()
    after = (31 if stops else 43) * STEP
    assert found.times[43] == pytest.approx(after, abs=1e-9)


def test_frames_that_are_missing_without_a_trace_are_given_time():
    shown = np.delete(np.arange(COUNT), [12, 58, 59])
    found = mended(swing(), shown)
    assert found.missing == ((12, 1), (57, 2)) and not found.doubled
    np.testing.assert_allclose(found.times, shown * STEP)


def test_a_gap_in_the_stamps_is_not_counted_twice():
    shown = np.delete(np.arange(COUNT), [12, 58, 59])
    assert mended(swing(), shown, shown * STEP).missing == ()


@pytest.fixture(scope="module")
def broken_clip(tmp_path_factory):
    """Ten frames of another scene, then a swing with a doubled frame."""
    path = tmp_path_factory.mktemp("clip") / "broken.avi"
    frames = drawn(swing())
    frames[45] = frames[44]
    sheet = np.linspace(0, 255, SIDE).astype(np.uint8)[:, None, None]
    title = np.broadcast_to(sheet, (10, *frames.shape[1:]))
    write_video(path, np.concatenate([title, frames]), 30.0)
    return path


def test_a_clip_is_followed_after_its_cut_and_counted_from_its_begin(broken_clip):
    found = follow_clip(broken_clip, ClipSelection(), MotionBinder())
    assert found.motion.positions.shape[1] == len(found.video.frames) == 10 + COUNT
    assert found.motion.shown() == (10, 10 + COUNT) and not found.motion.seen[0, 55].any()
    assert found.used.left_out == (55,)
    assert found.used.line(10, 90, ["more"]) == (
        "Frames 10 to 89 of 90 are used: cut before frame 10; 1 doubled frame left out (55); more."
    )
    late = follow_clip(broken_clip, ClipSelection(start=4), MotionBinder())
    assert late.used.left_out == (55,) and late.used.line(6, 86, []).startswith("Frames 10 to 89 ")


def test_a_place_is_told_by_the_frame_of_the_clip(broken_clip):
    x, y = swing()[10]
    told = Wanted(at=((float(x), float(y), 20),))
    found = follow_clip(broken_clip, ClipSelection(start=2), MotionBinder(bodies=None, wanted=told))
    assert found.motion.bodies == 1
    place = found.motion.positions[0, 18, 0]
    assert np.allclose(place * [48, -48] + 47.5, [x, y], atol=1.0)


def test_all_frames_are_named_where_nothing_is_left_out():
    assert Used(7).line(0, 7, []) == "Frames 0 to 6 of 7 are used."
    assert Used(None, 3).line(0, 7, []) == "Frames 3 to 9 are used."
