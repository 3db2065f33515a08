"""A law over several clips, of many numbers at once: what is the same is rolled once."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
import pytest

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Arc, Plane
from vidphys.diagnose.mechanisms.fitted import Model, solved
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.measurement import Stretch
from vidphys.diagnose.mechanisms.uncertainty import slopes_of

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


def _model(law: Law = LAW) -> Model:
    return Model(law, (Plane(law.coordinates),))


@pytest.mark.parametrize("clips", [_clips(), _clips()[::-1], _clips()[:1]])
def test_many_values_are_rolled_as_each_by_itself(clips):
    count = 3 + 2 * len(clips)
    nudges = 1e-3 * np.eye(count)
    many = VALUES[:count] + np.concatenate([nudges, -nudges])
    together = _model().coordinates(many, clips)
    for values, *paths in zip(many, *together, strict=True):
        for found, expected in zip(paths, _rolled_afresh(values, clips), strict=True):
            np.testing.assert_array_equal(found, expected)


def test_a_start_of_one_clip_rolls_no_other():
    clips = _clips()
    many = np.repeat(VALUES[None], 5, 0)
    many[1:, 5] += 1e-3 * np.arange(4)  # where the second clip starts
    with patch.object(Law, "roll", autospec=True, side_effect=Law.roll) as roll:
        _model().coordinates(many, clips)
    assert [len(call.args[1]) for call in roll.call_args_list] == [1, 4, 1]


def test_a_camera_that_turns_rolls_nothing_again():
    law = Law(2, "uniform", pictured=True)
    many = np.repeat(np.array([0.0, -9.8, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0])[None], 4, 0)
    many[:, 2:5] += 1e-3 * np.arange(12).reshape(4, 3)
    with patch.object(Law, "roll", autospec=True, side_effect=Law.roll) as roll:
        rolled = _model(law).coordinates(many, _clips()[:1])[0]
    assert [len(call.args[1]) for call in roll.call_args_list] == [1]
    assert rolled.shape == (4, 20, 2, 2)


def test_derivatives_of_what_is_told_are_those_of_its_numbers_one_by_one():
    rng = np.random.default_rng(3)
    times = 0.05 * np.arange(30)
    places = 0.2 * rng.normal(size=(30, 2))
    stretch = Stretch(times, places, np.ones(30))
    clips = [Frames(times, (np.arange(30),), (stretch,))]
    model = Model(Law(1, "pendulum", "linear", pictured=True), (Arc(aslant=True),))
    values = np.array([10.0, 0.1, 0.05, -0.1, 0.02, 0.4, 0.3])
    geometry = np.array([0.1, -0.2, 0.5, 0.03, -0.02, 0.48])
    joint = np.concatenate([values, geometry])
    found = slopes_of(clips, model, joint, 1.0)[0]

    def told(numbers: np.ndarray) -> np.ndarray:
        s = model.coordinates(numbers[:7], clips)[0][:, 0]
        return view.seen(model.charts[0].shown(s, numbers[7:]), numbers[2:5])

    for i, column in enumerate(np.moveaxis(found, -1, 0)):
        nudge = 1e-5 * np.eye(len(joint))[i]
        np.testing.assert_allclose(
            column, (told(joint + nudge) - told(joint - nudge)) / 2e-5, atol=1e-8
        )


def test_a_chart_is_drawn_at_its_best_for_each_of_many_and_where_its_columns_are_nothing():
    rng = np.random.default_rng(4)
    design, rest = rng.normal(size=(3, 12, 4)), rng.normal(size=(3, 12, 1))
    design[1, :, 2] = 0.0  # tells nothing of one number
    design[2, 0, 0] = np.inf
    found = solved(design, rest)
    for i in (0, 1):
        best = np.linalg.lstsq(design[i], rest[i], rcond=None)[0]
        np.testing.assert_allclose(found[i], best, atol=1e-12)
    assert not found[2].any()
