"""Pictures in a file are those that are held in memory, and a clip in a file is followed alike."""

from __future__ import annotations

import numpy as np
import pytest

from binders import MotionBinder
from binders import reel as module
from binders.reel import Masks, filled
from tests.binders.test_motion import draw, swing, times, wobble


@pytest.mark.parametrize("most", [0, 3 * 24, 2**20])
def test_a_reel_and_its_masks(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "HELD", most)
    whole = np.random.default_rng(0).integers(0, 256, (7, 2, 4, 3), np.uint8)
    reel = filled(iter(whole))
    assert reel.shape == whole.shape and len(reel) == 7
    assert np.array_equal(np.stack([*reel]), whole)
    for k in (3, 0, -1, 6):
        assert np.array_equal(reel[k], whole[k])
    assert np.array_equal(reel[[5, 1, 5]], whole[[5, 1, 5]])
    with pytest.raises(IndexError):
        reel[7]
    masks = Masks((5, 3))
    flags = np.random.default_rng(1).random((4, 5, 3)) < 0.5
    for flag in flags:
        masks.append(flag)
    assert masks.shape == flags.shape and masks[2].dtype == bool
    assert np.array_equal(np.stack([*masks]), flags)


def test_a_clip_in_a_file_is_followed_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = draw(swing()[:24, None], wobble()[:24])
    when = times()[:24]
    held = MotionBinder()(frames, when)
    monkeypatch.setattr(module, "HELD", 0)
    filed = MotionBinder()(frames, when)
    assert np.array_equal(held.tracks.positions, filed.tracks.positions)
    assert np.array_equal(held.camera, filed.camera)
    assert held.others == filed.others
