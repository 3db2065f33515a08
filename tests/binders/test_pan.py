"""A camera that turns far: its homographies, and bodies as its first frame would have seen them."""

from __future__ import annotations

import cv2
import numpy as np

from binders.motion import MotionBinder
from binders.pan import through, turning, unturned
from tests.binders.test_motion import HEIGHT, WIDTH, disc, draw, pixels, swing, times, wobble

FRAMES, FOCAL = 60, 110.0  # pixels
T = np.arange(FRAMES)
CORNERS = np.array([[0.0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT]])
WAY = np.stack([60 + 18 * np.cos(0.25 * T), np.full(FRAMES, 50.0)], 1)  # before the middle frame


def lens() -> np.ndarray:
    return np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])


def turned() -> np.ndarray:
    """Homographies from the middle frame to each, of a camera that turns by 12 degrees in all."""
    angles = np.radians(12) * (T - FRAMES // 2) / FRAMES
    zero, one = np.zeros(FRAMES), np.ones(FRAMES)
    c, s = np.cos(angles), np.sin(angles)
    turns = np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]]).transpose(2, 0, 1)
    return lens() @ turns @ np.linalg.inv(lens())


def panned(body: bool = True) -> np.ndarray:
    """A wall of many patches, and a disc before it."""
    rng = np.random.default_rng(2)
    wall = cv2.resize(rng.uniform(90, 170, (24, 32, 3)), (4 * WIDTH, 3 * HEIGHT))
    for _ in range(150):
        y, x = rng.integers(0, 3 * HEIGHT), rng.integers(0, 4 * WIDTH)
        wall[y : y + 9, x : x + 7] = rng.uniform(40, 220, 3)
    middle = np.array([[1, 0, -1.5 * WIDTH], [0, 1, -HEIGHT], [0, 0, 1.0]])
    places = through(turned(), WAY[:, None])[:, 0]
    frames = []
    for turn, place in zip(turned(), places, strict=True):
        image = cv2.warpPerspective(wall, turn @ middle, (WIDTH, HEIGHT))
        ball = disc(place, 6.0) * body
        image = image * (1 - ball) + np.array([220.0, 20, 20]) * ball
        frames.append(image + rng.normal(scale=1.5, size=image.shape))
    return np.clip(np.stack(frames), 0, 255).astype(np.uint8)


def test_homographies_of_a_camera_that_turns() -> None:
    found = turning(panned())
    assert found is not None
    four = np.tile(CORNERS, (FRAMES, 1, 1))
    assert np.abs(through(found, four) - through(turned(), four)).max() < 0.7


def test_frames_as_the_middle_one_sees_them() -> None:
    frames = panned(body=False)
    still, shown = (np.stack([*each]) for each in unturned(frames, turned()))
    off = np.abs(still.astype(float) - frames[FRAMES // 2])[shown]
    assert np.median(off) < 4
    assert shown[FRAMES // 2].all()
    assert 0.7 < shown[0].mean() < 0.95


def test_a_camera_that_hardly_turns_is_not_said_to() -> None:
    assert turning(draw(swing()[:, None], wobble())) is None


def test_a_body_is_where_the_first_frame_would_have_seen_it() -> None:
    found = MotionBinder(bodies=1)(panned(), times())
    camera = found.camera.numpy() * max(HEIGHT, WIDTH) / 2 * [1, -1]
    steady = pixels(found)[:, 0] - camera
    expected = through(np.tile(turned()[0], (FRAMES, 1, 1)), WAY[:, None])[:, 0]
    assert np.linalg.norm(steady - expected, axis=-1).max() < 1.0
    assert np.ptp(camera, 0)[0] > 15
