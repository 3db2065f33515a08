"""Slot attention, what it learns from, and the two rungs in which detection is learned."""

from dataclasses import replace

import pytest
import torch

from binders.slots import SlotAttention, Slots, SlotSettings
from encoders.features import FeatureMap
from encoders.identity import EncoderIdentity
from renderers import AnonymousWorld, Camera, ChannelWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.errors import InputError
from vidphys.perception import composed
from vidphys.perception.base import FitTask
from vidphys.perception.catalogue import RUNGS
from vidphys.perception.dreams import Dreams, light_spread
from vidphys.perception.reconstruction import Reconstruction, told
from vidphys.perception.slots import (
    Answer,
    FrameTokens,
    SlotDetector,
    decided,
    fit_slots,
    mirrored,
)
from vidphys.presets import PixelSizes
from vidphys.scenes import gravity
from vidphys.training.loop import FitSettings, fit

CHANNELS = SlotSettings().channels
WORLD = AnonymousWorld(Camera(4.0, 16, 16), radius=1.0, softness=0.2)
SIZES = PixelSizes(8, 8, 40, 16, 2, 6, 0, 4)


@pytest.fixture
def slots() -> SlotAttention:
    torch.manual_seed(0)
    module = SlotAttention()
    torch.nn.init.normal_(module.correct.weight, std=0.1)
    return module


@pytest.fixture(scope="module")
def clips() -> Clips:
    return render_clips(gravity(mass=(1.0, 1.0)), WORLD, SIZES.clips, SIZES.frames, 40, 0, "train")


def features(clips: int = 2, frames: int = 3) -> FeatureMap:
    values = torch.randn(clips, frames, CHANNELS, 4, 5, generator=torch.Generator().manual_seed(1))
    return FeatureMap(values, (2.0, 2.0), torch.arange(float(frames)))


def scattered(bodies: int = 4) -> Slots:
    rng = torch.Generator().manual_seed(2)
    return Slots(torch.randn(2, bodies, 72, generator=rng), torch.rand(2, bodies, 2, generator=rng))


class Edges(torch.nn.Module):
    """Two layers of convolution, for a training that is over soon."""

    def __init__(self):
        super().__init__()
        self.layers = torch.nn.Sequential(
            torch.nn.Conv2d(1, CHANNELS, 5, 2, 2),
            torch.nn.ReLU(),
            torch.nn.Conv2d(CHANNELS, CHANNELS, 3, 1, 1),
        )

    def forward(self, frames):
        values = self.layers(frames.flatten(0, 1)).unflatten(0, frames.shape[:2])
        return FeatureMap(values, (2.0, 2.0), torch.zeros(frames.shape[1]))


def detector(bodies: int = 2) -> SlotDetector:
    torch.manual_seed(0)
    fine = Reconstruction.through(WORLD).fine
    return SlotDetector(Edges(), bodies, WORLD.camera.half_extent, fine)


# --- the module ---


def test_the_binder_has_the_studys_number_of_parameters(slots):
    assert sum(p.numel() for p in slots.parameters()) == 105_728


def test_slots_in_another_order_find_the_same_in_that_order(slots):
    order = torch.tensor([2, 0, 3, 1])
    start = scattered()
    plain = slots(features(), start)
    other = slots(features(), Slots(start.state[:, order], start.position[:, order]))
    assert not torch.allclose(plain[-1].rounds, plain[-1].rounds[:, :, order], atol=1e-3)
    for a, b in zip(plain, other, strict=True):
        torch.testing.assert_close(a.rounds[:, :, order], b.rounds)
        torch.testing.assert_close(a.doubt[:, order], b.doubt)


def test_attention_sums_to_one_and_slots_compete_for_cells(slots):
    keys = torch.randn(2, 6, 12, 20)
    centres = torch.rand(20, 2)
    alone, crowded = scattered(1), scattered(4)
    crowded = Slots(
        torch.cat([alone.state, crowded.state[:, 1:]], 1),
        torch.cat([alone.position, crowded.position[:, 1:]], 1),
    )
    background = torch.zeros(2, 6, 1, 20)
    attention = slots.attend(keys, centres, background, crowded)
    assert bool((attention >= 0).all())
    torch.testing.assert_close(attention.sum(-1), torch.ones(2, 6, 4), atol=1e-3, rtol=0)
    free = slots.attend(keys, centres, background, alone)
    assert not torch.allclose(attention[:, :, :1], free, atol=1e-3)


def test_what_slots_see_moves_with_the_picture(slots):
    inside = torch.zeros(1, 1, CHANNELS, 24, 24)
    inside[..., 8:14, 8:14] = torch.randn(CHANNELS, 6, 6)
    moved = inside.roll((3, -2), (-2, -1))
    shift = torch.tensor([-2.0, -3.0]) * 2 / 24  # cells; 24 are 2 units
    start = slots.start(1, 3)
    slots.background.bias.data += 4  # empty cells are nobody's, however many lie on each side
    slots.background.weight.data.zero_()
    with torch.no_grad():
        here = slots(FeatureMap(inside, (2.0, 2.0), torch.zeros(1)), start)[0]
        there = slots(
            FeatureMap(moved, (2.0, 2.0), torch.zeros(1)),
            Slots(start.state, start.position + shift),
        )[0]
    torch.testing.assert_close(here.rounds[:, 0] + shift, there.rounds[:, 0], atol=0.04, rtol=0)


def test_slots_go_on_from_where_they_were(slots):
    """The same frame again: what is carried makes the answer another one, time and again."""
    still = FeatureMap(features(1, 1).values.expand(-1, 3, -1, -1, -1), (2.0, 2.0), torch.zeros(3))
    found = slots(still, slots.start(1, 2))
    alone = slots.look(
        slots.norm_cell(still.values[:, 1].flatten(2).mT),
        still.cell_centres().flatten(0, 1),
        found[0].slots,
        found[1].rounds.shape[1],
    )
    torch.testing.assert_close(alone.rounds, found[1].rounds)
    assert found[0].rounds.shape[1] > found[1].rounds.shape[1]


def test_features_of_other_channels_are_refused(slots):
    wrong = FeatureMap(torch.zeros(1, 1, 3, 4, 4), (2.0, 2.0), torch.zeros(1))
    with pytest.raises(ValueError, match="project the features first"):
        slots(wrong, slots.start(1, 2))


# --- what it learns from ---


def test_a_frame_is_explained_from_positions_nearby_or_from_its_neighbours():
    teacher = Reconstruction.through(WORLD)
    truth = torch.tensor([[-2.0, 0.0], [2.0, 1.0]]).expand(1, 3, -1, -1)
    frames = WORLD(truth)
    start = truth + 0.4
    start[:, 1] = torch.tensor([[-2.0, -0.5], [-2.0, 0.5]])  # both on one body
    alone = teacher.explain(frames[:, 1:2], start[:, 1:2])
    assert not bool(alone.believed)
    together = teacher.explain(frames, start)
    assert bool(together.believed.all())
    torch.testing.assert_close(together.positions, truth, atol=1e-2, rtol=0)


def test_a_body_that_stands_where_none_is_is_set_down_where_two_passed_for_one():
    teacher = Reconstruction.through(WORLD)
    truth = torch.tensor([[-2.0, 0.0], [2.0, 1.0], [2.2, 0.8]]).expand(1, 2, -1, -1)
    frames = WORLD(truth)
    start = truth.clone()
    start[:, :, 1] = torch.tensor([-2.1, 0.1])  # one of the pair stands at the single body
    stuck = teacher.explain(frames, start)
    assert not bool(stuck.believed.any())
    found = teacher.regrouped(frames, stuck)
    assert bool(found.believed.all())
    missed = torch.cdist(truth, found.positions).amin(-1)  # a pair that looks alike may be swapped
    assert missed.max() < 1e-2
    blank = teacher.regrouped(torch.zeros_like(frames), stuck)
    assert not bool(blank.believed.any()) and torch.equal(blank.positions, stuck.positions)


def test_what_slots_propose_is_moved_to_where_it_explains_the_frame_and_else_left():
    world = AnonymousWorld(Camera(4.0, 32, 32), radius=1.0, softness=0.2)
    q = torch.tensor([[[[-1.5, 0.5], [1.0, -1.0]]]])
    frames = world(q)
    unsure = torch.full((1, 1, 2), 0.3)
    teacher = Reconstruction.through(world)
    moved, sure = decided(teacher, frames, q + 0.2, unsure)
    assert (moved - q).abs().max() < 1e-3 and (sure == 1).all()
    blank = torch.zeros_like(frames)
    kept, still = decided(teacher, blank, q, unsure)
    assert torch.equal(kept, q) and torch.equal(still, unsure)


def test_errors_fall_towards_the_truth_and_an_unexplained_frame_still_draws():
    teacher = Reconstruction.through(WORLD)
    truth = torch.tensor([[-2.0, 0.0], [2.0, 1.0]]).expand(1, 1, -1, -1)
    frames = WORLD(truth)
    at = told(truth, truth)
    tries = torch.stack([truth + x for x in (0.0, 0.01, 1.0)], 1)
    error, apart = teacher.error(tries, at, frames)
    assert float(error[0, 0].max()) == 0
    assert bool((error[:, 1:].diff(dim=1) > 0).all())
    lost = replace(at, believed=torch.zeros_like(at.believed))
    somewhere = (truth + 0.5).unsqueeze(1).requires_grad_()
    dim, known = teacher.error(somewhere, lost, frames)
    dim.sum().backward()
    assert bool((somewhere.grad * 0.5 > 0).all())  # downhill is back
    assert bool((known > apart[:, 2:].amin() - 1e-6).all() or (known == known[0, 0, 0, 0]).all())


def test_known_positions_are_numbered_as_they_were_found():
    truth = torch.randn(3, 2, 3, 2)
    order = torch.tensor([2, 0, 1])
    found = truth[:, :, order] + 0.01
    torch.testing.assert_close(told(truth, found).positions, truth[:, :, order])


def test_dreams_are_drawn_as_clips_are_and_come_back(clips):
    dreams = Dreams(WORLD, 2, 1.0, 3, 0)
    index = torch.tensor([5, 1, 9])
    one, same, other = dreams[index], dreams[index], dreams[index + 1]
    assert torch.equal(one.frames, same.frames) and not torch.equal(one.frames, other.frames)
    torch.testing.assert_close(one.frames, WORLD(one.positions), atol=0.5 / 255 + 1e-6, rtol=0)
    assert torch.equal((one.frames * 255).round() / 255, one.frames)
    step = one.positions.diff(dim=1)
    torch.testing.assert_close(step[:, 0], step[:, 1])
    rms = float(clips.states.q.square().mean().sqrt())
    assert 0.8 * rms < light_spread(clips) < 1.6 * rms


def test_large_frames_are_averaged_down_and_cells_stay_where_they_were():
    small, large = (FrameTokens()(torch.rand(1, 1, 1, side, side)) for side in (32, 64))
    assert small.grid == large.grid == (16, 16)
    torch.testing.assert_close(small.cell_centres(), large.cell_centres())


def test_frames_are_seen_in_eight_orientations():
    frames = torch.rand(1, 1, 1, 4, 4)
    assert len({tuple(mirrored(frames, k).flatten().tolist()) for k in range(8)}) == 8
    ways = frames, frames.flip(-1), frames.flip(-2), frames.flip(-1, -2)
    for k, way in enumerate(ways):
        assert torch.equal(mirrored(frames, k), way)
    wide = torch.rand(1, 1, 1, 4, 6)
    assert all(mirrored(wide, k).shape == wide.shape for k in range(8))


def test_in_each_frame_the_better_answer_stands():
    rng = torch.Generator().manual_seed(0)
    one, two = (
        Answer(*(torch.rand(2, 3, *more, generator=rng) for more in ((4, 2), (4,), ())))
        for _ in range(2)
    )
    both = one.or_else(two)
    for clip in range(2):
        for frame in range(3):
            want = min(one, two, key=lambda answer: answer.unlike[clip, frame])  # noqa: B023
            for name in ("positions", "doubt", "unlike"):
                assert torch.equal(
                    getattr(both, name)[clip, frame], getattr(want, name)[clip, frame]
                )


def test_frames_decide_only_where_they_are_to():
    """Then slots start from several rings, and a frame that is not explained is doubted."""
    frames = WORLD(torch.tensor([[-2.0, 0.5], [1.5, -1.0]]).expand(1, 1, -1, -1))
    sure, asked = {}, {}
    for decides in (True, False):
        one = detector()
        one.settings = replace(one.settings, decided=decides)
        turns = asked[decides] = []
        follow = one.follow
        one.follow = lambda tokens, turn, follow=follow, turns=turns: (
            turns.append(turn) or follow(tokens, turn)
        )
        with torch.no_grad():
            sure[decides] = one.detect(frames, frames, WORLD)[1]
    assert len(asked[True]) == detector().settings.starts > 1 == len(asked[False])
    assert float(sure[True].max()) < float(sure[False].min())


def test_a_short_training_finds_two_separate_disks():
    trained, teacher = detector(), Reconstruction.through(WORLD)
    places = torch.tensor([[-2.0, 0.5], [1.5, -1.0]]).expand(1, 1, -1, -1)
    frames = WORLD(places)

    def miss() -> tuple[float, float]:
        with torch.no_grad():
            positions, confidence = trained.detect(frames, frames, WORLD)
        near = torch.cdist(places[0, 0], positions[0, 0]).amin(1)
        return float(near.max()), float(confidence.mean())

    before, _ = miss()
    losses = []
    fit(
        trained,
        lambda dream: trained.loss(dream.frames, dream.frames, teacher, dream.positions),
        Dreams(WORLD, 2, 1.5, 1, 0),
        FitSettings(60, 12, 5e-3, 1.0),
        0,
        progress=lambda step, steps, loss: losses.append(loss),
    )
    after, sure = miss()
    assert sum(losses[-10:]) < 0.8 * sum(losses[:10])
    assert after < 0.5 < before
    assert 0 < sure <= 1


# --- the rungs ---


class Blocks:
    """Light averaged over blocks of two pixels: features that anybody can check."""

    identity = EncoderIdentity("blocks", 1, "0" * 64, "none", "0", 16, "float32")

    def __call__(self, frames, times, progress=None):
        light = frames.float().flatten(0, 1) / 255
        values = torch.nn.functional.avg_pool2d(light, 2)
        return FeatureMap(values.unflatten(0, frames.shape[:2]), (2.0, 2.0), times)


def composed_of_blocks(task):
    return composed.fit_composed("blocks", {}, task)


@pytest.mark.parametrize("fit_rung", [fit_slots, composed_of_blocks])
def test_no_label_is_read_and_tracks_have_the_shape_of_the_truth(fit_rung, clips, monkeypatch):
    monkeypatch.setattr(composed, "load_encoder", lambda name, options, device: Blocks())
    blind = replace(clips, states=clips.states.map(lambda x: torch.full_like(x, torch.nan)))
    seeing, unseeing = (
        fit_rung(FitTask(c, SIZES, 0, "factored")).tracks(clips) for c in (clips, blind)
    )
    assert torch.equal(seeing.positions, unseeing.positions)
    assert seeing.positions.shape == clips.states.q.shape
    assert bool(((seeing.confidence > 0) & (seeing.confidence <= 1)).all())


@pytest.mark.parametrize("fit_rung", [fit_slots, composed_of_blocks])
def test_another_world_is_refused(fit_rung, clips):
    with pytest.raises(InputError, match="anonymous"):
        fit_rung(FitTask(replace(clips, world=ChannelWorld()), SIZES, 0, "factored"))


def test_the_rungs_are_listed():
    assert {"anonymous-slots", "composed-hiera"} <= set(RUNGS)
