"""Clips that break their law, and whether a model that knows the law is surprised."""

import pytest
import torch
from torch import Generator

from binders import Tracks
from renderers import Camera, ChannelWorld
from vidphys.data.clips import render_clips
from vidphys.experiments.pixels.broken import (
    AT_A_STRIKE,
    BREAKS,
    LAWFUL,
    PASSED,
    VANISHED,
    broken,
)
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.experiments.pixels.surprise import AHEAD, CONTEXTS, surprise
from vidphys.metrics import above, auroc
from vidphys.scenes.strikes import strikes

FRAMES = CONTEXTS[-1] + 2 * AHEAD
STRIDE = 40


@pytest.fixture(scope="module")
def made():
    world = ChannelWorld(Camera(height=24, width=24))
    clips = render_clips(pixel_scene(), world, 12, FRAMES, STRIDE, 0, "surprise")
    rng = Generator().manual_seed(0)
    return broken(pixel_scene(), clips, STRIDE, CONTEXTS[-1] + 1, rng)


@pytest.mark.parametrize("name", sorted(BREAKS))
def test_a_broken_clip_parts_from_its_twin_at_the_break_and_not_before(made, name):
    lawful, other = made.clips[LAWFUL], made.clips[name]
    differ = (lawful.frames != other.frames).flatten(2).any(-1)  # (b, t)
    before = torch.arange(FRAMES) < made.at[:, None]
    assert len(made.at) >= 6
    assert not differ[before].any()
    assert differ[:, -1].all()
    assert torch.equal(lawful.params.coupling, other.params.coupling)


@pytest.fixture(scope="module")
def struck():
    world = ChannelWorld(Camera(height=24, width=24))
    clips = render_clips(strikes(), world, 24, FRAMES + AHEAD, STRIDE, 0, "strikes")
    rng = Generator().manual_seed(0)
    return broken(strikes(), clips, STRIDE, CONTEXTS[-1] + 1, rng, AT_A_STRIKE)


def test_bodies_that_strike_go_through_one_another(struck):
    rows = torch.arange(len(struck.at))
    assert len(rows) >= 6

    def gap(name):  # of the pair that strikes
        q = struck.clips[name].states.q
        i, j = torch.triu_indices(3, 3, offset=1)
        apart = q[..., i, :] - q[..., j, :]  # (b, t, pairs, 2)
        pair = apart[rows, struck.at].norm(dim=-1).argmin(-1)
        return apart[rows, :, pair]

    lawful, passed = gap(LAWFUL), gap(PASSED)
    before = torch.arange(lawful.shape[1]) < struck.at[:, None]
    assert torch.equal(lawful[before], passed[before])
    nearest = [x.norm(dim=-1).masked_fill(before, torch.inf).amin(1) for x in (lawful, passed)]
    assert float(nearest[0].min()) > 0.45  # disks of diameter 0.7 give way a little
    assert float(nearest[1].median()) < 0.3


@pytest.mark.slow
def test_the_law_of_strikes_is_surprised_where_bodies_go_through_one_another(struck):
    found = {}
    for name, clips in struck.clips.items():
        tracks = Tracks(clips.states.q, torch.ones(clips.states.q.shape[:3]), clips.times)
        found[name] = surprise(strikes().law, tracks, clips.params, clips.interval, 7, 0.003)
    assert auroc(found[PASSED], found[LAWFUL]).value >= 0.95


def test_the_first_body_alone_vanishes(made):
    light = made.clips[VANISHED].frames[:, -1].flatten(2).sum(-1)  # of each body's channel
    assert (light[:, 0] == 0).all()
    assert (light[:, 1:] > 0).all()


def test_what_turns_keeps_its_speed_across_its_course_and_what_stops_loses_it(made):
    def moved(name):
        q = made.clips[name].states.q
        rows = torch.arange(len(q))
        return q[rows, made.at] - q[rows, made.at - 1]  # (b, n, 2)

    lawful, turned = moved(LAWFUL)[:, 0], moved("turned")[:, 0]
    ratio = turned.norm(dim=-1) / lawful.norm(dim=-1)
    cosine = torch.cosine_similarity(turned, lawful)
    assert (ratio - 1).abs().median() < 0.05
    assert cosine.abs().median() < 0.2
    slow = moved("stopped").norm(dim=-1) < 0.3 * moved(LAWFUL).norm(dim=-1)
    assert slow.double().mean() > 0.75  # some fall at once


def test_the_true_law_is_surprised_by_every_break_and_by_no_lawful_clip(made):
    scene, found = pixel_scene(), {}
    for name, clips in made.clips.items():
        tracks = Tracks(clips.states.q, torch.ones(clips.states.q.shape[:3]), clips.times)
        found[name] = surprise(scene.law, tracks, clips.params, clips.interval, 7, 0.003)
    lawful = found.pop(LAWFUL)
    assert float(lawful.median()) < 2e-3
    for name, values in found.items():
        assert auroc(values, lawful).value >= 0.95, name
        assert above(values, lawful).value >= 0.95, name


def test_shares_of_pairs_count_ties_half_and_lost_ones_apart():
    high, low = torch.tensor([3.0, 2.0, torch.nan]), torch.tensor([1.0, 2.0, 5.0])
    found = auroc(high, low)
    assert (found.value, found.episodes, found.nonfinite) == (3.5 / 6, 6, 1)
    assert (above(high, low).value, above(high, low).nonfinite) == (0.75, 1)
    assert auroc(high[2:], low).status == "failed"
