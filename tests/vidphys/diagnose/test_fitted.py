"""A law over several clips: what is rolled once is not rolled again, and no clip gets another's."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fitted import Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.measurement import Stretch

LAW = Law(1, "trap", "linear")  # stiffness, steady force, friction
VALUES = np.array([4.0, 0.5, 0.1, 1.0, 0.0, -1.0, 0.5, 0.3, 2.0])  # and three starts


def _clip(frames: int, interval: float) -> Frames:
    times = interval * np.arange(frames)
    stretch = Stretch(times, np.zeros((frames, 1)), np.ones(frames))
    return Frames(times, (np.arange(frames),), (stretch,))


def _clips() -> list[Frames]:
    return [_clip(20, 0.1), _clip(30, 0.1), _clip(20, 0.05)]


def _rolled_afresh(values: np.ndarray, clips: list[Frames]) -> list[np.ndarray]:
    starts = values[3:].reshape(len(clips), 2, 1)
    return [LAW.roll(values[:3], s, c.times) for s, c in zip(starts, clips, strict=True)]


def _model() -> Model:
    return Model(LAW, (Plane(1),))


def test_a_derivative_by_a_start_rolls_that_clip_alone():
    model, clips = _model(), _clips()
    model.coordinates(VALUES, clips)
    moved = VALUES.copy()
    moved[5] += 1e-3  # where the second clip starts
    with patch.object(Law, "roll", autospec=True, side_effect=Law.roll) as roll:
        rolled = model.coordinates(moved, clips)
        assert [len(call.args[3]) for call in roll.call_args_list] == [30]
    for found, expected in zip(rolled, _rolled_afresh(moved, clips), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_another_law_rolls_every_clip(number: int):
    model, clips = _model(), _clips()
    model.coordinates(VALUES, clips)
    moved = VALUES.copy()
    moved[number] += 1e-3
    for found, expected in zip(
        model.coordinates(moved, clips), _rolled_afresh(moved, clips), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


def test_other_clips_get_their_own():
    model, clips = _model(), _clips()
    model.coordinates(VALUES, clips)
    for others in (clips[::-1], [clip.upto(10) for clip in clips], clips[:2]):
        values = VALUES[: 3 + 2 * len(others)]
        for found, expected in zip(
            model.coordinates(values, others), _rolled_afresh(values, others), strict=True
        ):
            np.testing.assert_array_equal(found, expected)


def test_what_is_kept_cannot_be_changed_by_who_asked():
    rolled = _model().coordinates(VALUES, _clips())
    with pytest.raises(ValueError, match="read-only"):
        rolled[0][0] = 0.0
