"""Cuts of clips: found where two takes were joined, and not where the camera or the light does."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from vidphys.data.cuts import liveliest, parts
from vidphys.data.video import ClipSelection, open_video

REAL = os.environ.get("VIDPHYS_REAL")
COUNT, SIZE = 24, (72, 96)


def take(seed, count=COUNT, moves=3):
    """A bright ball before a room that is drawn by chance, with new noise in each frame."""
    rng = np.random.default_rng(seed)
    room = ndimage.gaussian_filter(rng.uniform(0, 255, (*SIZE, 3)), (6, 6, 0))
    room = 60 + 120 * (room - room.min()) / np.ptp(room)
    frames = room + 2 * rng.standard_normal((count, *SIZE, 3))
    for t, frame in enumerate(frames):
        frame[30:44, 4 + moves * t : 18 + moves * t] = 250
    return np.clip(frames, 0, 255).astype(np.uint8)


def test_a_cut_is_found_at_its_frame():
    joined = np.concatenate([take(0), take(1), take(2, 9)])
    assert parts(joined) == [(0, COUNT), (COUNT, 2 * COUNT), (2 * COUNT, 2 * COUNT + 9)]
    assert parts(take(0)) == [(0, COUNT)]


@pytest.mark.parametrize("what", ["push", "dimmed", "flash"])
def test_a_push_of_the_camera_and_other_light_are_no_cut(what):
    frames = take(3).astype(float)
    if what == "push":
        frames[12:] = np.roll(frames[12:], (6, -9), (1, 2))
    elif what == "dimmed":
        frames[12:] *= 0.6
    else:
        frames[12] = np.minimum(frames[12] + 90, 255)
    assert parts(frames.astype(np.uint8)) == [(0, COUNT)]


def test_the_part_that_moves_is_taken_rather_than_a_longer_title():
    joined = np.concatenate([take(4, 60, moves=0), take(5), take(6, 12)])
    found = parts(joined)
    assert len(found) == 3 and liveliest(joined, found) == 1


@pytest.mark.skipif(REAL is None, reason="set VIDPHYS_REAL to the folder of recordings")
@pytest.mark.parametrize(
    "clip, cuts",
    [("pucks_repelling.ogv", 1), ("puck_constant_force.avi", 1), ("ball_bounce.avi", 0)],
)
def test_sheets_of_paper_at_the_begin_of_real_clips_are_cut_off(clip, cuts):
    frames = open_video(Path(REAL or "") / clip, ClipSelection()).frames
    found = parts(frames)
    assert len(found) == 1 + cuts and found[liveliest(frames, found)][0] == 2 * cuts
