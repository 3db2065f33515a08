"""What is drawn on a picture, or beside it, holds no camera still."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from binders import MotionBinder
from binders.bars import FEWEST, RIM, without_bars
from binders.reel import filled
from binders.steadied import camera_path
from tests.binders.test_motion import HEIGHT, WIDTH, draw, swing, times, wobble


def barred(frames: np.ndarray, down: int, across: int) -> np.ndarray:
    return np.pad(frames, ((0, 0), (down, down), (across, across), (0, 0)))


@pytest.mark.parametrize(
    ("down", "across"),
    [
        pytest.param(0, 24, marks=pytest.mark.slow),
        pytest.param(16, 0, marks=pytest.mark.slow),
        (12, 20),
    ],
)
def test_a_hand_held_clip_is_followed_alike_with_bars(down: int, across: int) -> None:
    path, drift = swing()[:, None], wobble()
    found = MotionBinder()(barred(draw(path, drift), down, across), times())
    half = max(HEIGHT + 2 * down, WIDTH + 2 * across) / 2
    camera = found.camera.numpy() * [half, -half]
    assert np.abs(camera - (drift - drift[0])).max() < 0.3
    middle = np.array([WIDTH, HEIGHT]) / 2 - 0.5
    places = found.tracks.positions[0].numpy() * half * [1, -1] + middle
    error = np.linalg.norm(places - (path + drift[:, None]), axis=-1)
    assert np.median(error) < 0.5


def test_a_hand_held_clip_is_followed_alike_with_a_clock_drawn_on_it() -> None:
    path, drift = swing()[:, None], wobble()
    frames = draw(path, drift)
    for k, frame in enumerate(frames):
        cv2.putText(frame, f"REC 12:{k:02}", (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (255,) * 3)
    camera = camera_path(frames).numpy() * [WIDTH / 2, -WIDTH / 2]
    assert np.abs(camera - (drift - drift[0])).max() < 0.3


def test_only_what_is_always_dark_on_both_sides_is_a_bar() -> None:
    frames = np.random.default_rng(0).integers(60, 200, (4, 20, 30, 3), np.uint8)
    sides = frames.copy()
    sides[:, :, : FEWEST + 3] = sides[:, :, -FEWEST:] = 12
    once = sides.copy()
    once[2, 5, 0] = 90
    dark_room = 0 * frames
    for k, picture in enumerate(dark_room):
        picture[8:12, 6 + 4 * k : 12 + 4 * k] = 200  # a body that goes to and fro in it
    for pictures in (frames, sides[:, :, :-1], once, 0 * frames, dark_room):
        given = filled(iter(pictures))
        assert without_bars(given, [0, 1, 2, 3]) is given
    found = without_bars(filled(iter(sides)), [0, 1, 2, 3])
    first, last = FEWEST + 3 + RIM, 30 - FEWEST - RIM - 1
    np.testing.assert_array_equal(found[1][:, first : last + 1], sides[1][:, first : last + 1])
    np.testing.assert_array_equal(found[1][:, 0], sides[1][:, first])
    np.testing.assert_array_equal(found[1][:, -1], sides[1][:, last])
