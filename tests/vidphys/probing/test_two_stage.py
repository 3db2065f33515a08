import numpy as np
import pytest
import torch

from vidphys.probing.folds import CrossValidation, Question, fold_of
from vidphys.probing.readouts import Linear
from vidphys.probing.truth import Track
from vidphys.probing.two_stage import TwoStage

CLIPS, EACH, CELLS = 60, 5, 8


@pytest.fixture(scope="module")
def moving():
    """Bodies that run straight, in maps that show where one is and nothing of its motion."""
    rng = np.random.default_rng(0)
    start, velocity = rng.uniform(-0.4, 0.4, (CLIPS, 1, 2)), rng.uniform(-1, 1, (CLIPS, 1, 2))
    times = np.linspace(0, 0.5, EACH)
    places = start + velocity * times[:, None]
    centres = np.linspace(-1, 1, CELLS)
    blob = np.exp(-8 * (places[..., None] - centres) ** 2)
    maps = blob[..., 1, :, None] * blob[..., 0, None, :]
    clips = np.repeat(np.arange(CLIPS), EACH)
    track = Track(places.reshape(-1, 1, 2), np.tile(times, CLIPS), clips)
    values = np.broadcast_to(velocity, places.shape).reshape(-1, 2, 1)
    question = Question(values, np.ones(len(clips), bool))
    asked = CrossValidation([question], clips, fold_of(CLIPS, 4, 0), 0, True)
    return torch.from_numpy(maps.reshape(-1, 1, CELLS, CELLS)), track, asked, values


def score(said, true):
    return 1 - ((said - true) ** 2).mean() / true.var()


def test_motion_is_read_from_positions_where_no_frame_shows_it(moving):
    maps, track, asked, velocity = moving
    (said,) = TwoStage(track)(maps, asked)
    plain = CrossValidation(asked.questions, asked.groups, asked.folds)
    (flat,) = Linear()(maps, plain)
    assert score(said.raw, velocity) > 0.9 and score(flat.raw, velocity) < 0.6
    assert score(said.permuted, velocity) < 0.1
    assert np.all(said.doubt > 0) and said.forms == {"two-stage": 4}


def test_a_clip_that_is_tested_teaches_neither_stage(moving):
    """Its true places and its labels are spoilt, and what is said of it is the same."""
    maps, track, asked, velocity = moving
    (before,) = TwoStage(track)(maps, asked)
    tested = asked.folds[asked.groups] == 2
    spoilt = Track(np.where(tested[:, None, None], 99.0, track.positions), track.times, track.clips)
    values = np.where(tested[:, None, None], -99.0, velocity)
    other = CrossValidation([Question(values, asked.questions[0].known)], asked.groups, asked.folds)
    (after,) = TwoStage(spoilt)(maps, other)
    assert after.raw[tested] == pytest.approx(before.raw[tested])
    assert after.raw[~tested] != pytest.approx(before.raw[~tested])


def test_a_place_that_is_not_known_is_said(moving):
    _, track, _, _ = moving
    with pytest.raises(ValueError, match="the place of every body in every frame"):
        TwoStage(
            Track(np.where(track.positions > 0, np.nan, track.positions), track.times, track.clips)
        )
