"""The learned tracker, the anonymous rungs that are built on it, and what evaluation relabels."""

import itertools
import math
from dataclasses import replace

import jaxtyping
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from binders import Detections, Tracks, bind_by_acceleration, tracker
from binders.tracker import (
    Tracker,
    TrackerSettings,
    extrapolate,
    follow,
    follow_softly,
    pair_features,
    sinkhorn,
)
from dynamics import HEADS, Parameters, ballistic, build
from renderers import AnonymousWorld, Camera
from vidphys.data.clips import Clips, render_clips
from vidphys.errors import InputError
from vidphys.experiments.core.question import Question
from vidphys.experiments.pixels.momentum import MOMENTUM
from vidphys.experiments.pixels.seen import Seen, perceive
from vidphys.perception import detections
from vidphys.perception.anonymous import (
    ANONYMOUS_GROUNDINGS,
    LearnedBinding,
    TrackingSettings,
    hindsight_loss,
    prediction_loss,
)
from vidphys.perception.base import FitTask
from vidphys.perception.detections import detections_of, windows_of
from vidphys.perception.relabel import relabel
from vidphys.presets import PixelSizes
from vidphys.scenes import gravity
from vidphys.shooting.aim import aim, motion_under
from vidphys.shooting.step import roll
from vidphys.training.loop import FitSettings, fit

INTERVAL = 0.08
GROUNDINGS = {g.name: g for g in ANONYMOUS_GROUNDINGS}


@pytest.fixture
def plain() -> Tracker:
    torch.manual_seed(0)
    return Tracker()


def rng(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def found(positions: torch.Tensor, confidence: torch.Tensor | None = None) -> Detections:
    confidence = torch.ones(positions.shape[:-1]) if confidence is None else confidence
    return Detections(positions, confidence, INTERVAL * torch.arange(positions.shape[1]))


def shuffled(seen: Detections, seed: int, start: int = 1) -> Detections:
    """The same detections, in a new order in each frame from ``start`` on."""
    positions, confidence = seen.positions.clone(), seen.confidence.clone()
    generator = rng(seed)
    for clip, frame in itertools.product(range(len(positions)), range(start, len(seen.times))):
        order = torch.randperm(positions.shape[2], generator=generator)
        positions[clip, frame] = positions[clip, frame, order]
        confidence[clip, frame] = confidence[clip, frame, order]
    return Detections(positions, confidence, seen.times)


def curves(clips: int, frames: int, n: int, seed: int) -> torch.Tensor:
    """Bodies under constant acceleration, ``(b, t, n, 2)``."""
    generator = rng(seed)
    place, step, bend = torch.randn(3, clips, 1, n, 2, generator=generator)
    t = torch.arange(float(frames))[:, None, None]
    return 2 * place + 0.1 * step * t + 0.005 * bend * t**2


# the network and what it sees


def test_the_tracker_has_the_studys_size(plain):
    assert sum(p.numel() for p in plain.parameters()) == 4609


def test_features_are_what_they_are_said_to_be():
    past = torch.tensor([[[0.0, 0.0]], [[0.1, 0.0]]])
    guess = torch.tensor([[0.22, 0.01]])
    slots, confidence = torch.tensor([[0.19, 0.05]]), torch.tensor([0.7])
    near = TrackerSettings().near
    features = pair_features(past, guess, slots, confidence)[0, 0]
    error = torch.tensor([0.03, -0.04]) / near
    acceleration = torch.tensor([0.19 - 0.2, 0.05]) / near
    expected = [
        math.asinh(error[0]),
        math.asinh(error[1]),
        math.log1p(error.square().sum()),
        math.log1p(acceleration.square().sum()),
        0.7,
    ]
    torch.testing.assert_close(features, torch.tensor(expected))


def test_rows_are_tracks_and_columns_are_detections(plain):
    past = torch.randn(1, 3, 2, generator=rng(0))
    slots = past[0] + torch.tensor([[0.0, 0.0], [0.3, 0.0], [0.0, 0.0]])
    score = plain(past, past[0], slots, torch.ones(3))
    distance = torch.cdist(past[0], slots)
    expected = -(distance / plain.settings.near).square().log1p()
    torch.testing.assert_close(score, expected, atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("frames", [1, 2, 3, 5])
def test_extrapolation_is_exact_for_what_it_assumes(frames):
    order = min(frames, 3) - 1
    t = torch.arange(frames + 1.0)[:, None, None]
    truth = torch.randn(4, 2, generator=rng(0)) * t**order + 1.0
    torch.testing.assert_close(extrapolate(truth[:-1]), truth[-1])


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 5), st.floats(0.1, 2.0), st.integers(0, 1000))
def test_soft_assignments_are_doubly_stochastic(n, size, seed):
    part = sinkhorn(size * torch.randn(3, n, n, generator=rng(seed)))
    torch.testing.assert_close(part.sum(-2), torch.ones(3, n), atol=1e-4, rtol=0)
    torch.testing.assert_close(part.sum(-1), torch.ones(3, n), atol=0.01, rtol=0)


def test_sinkhorn_only_scales_rows_and_columns():
    logits = torch.randn(4, 4, generator=rng(1), dtype=torch.float64)
    ratio = sinkhorn(logits) / logits.exp()
    torch.testing.assert_close(ratio * ratio[0, 0], ratio[:, :1] * ratio[:1])


# following


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 4), st.sampled_from([1, 6]), st.integers(0, 1000))
def test_the_order_of_detections_means_nothing(n, hypotheses, seed):
    torch.manual_seed(0)
    network = Tracker()
    seen = found(curves(2, 7, n, seed) + 0.05 * torch.randn(2, 7, n, 2, generator=rng(seed)))
    tracks, score = follow(network, seen, hypotheses=hypotheses)
    again, same = follow(network, shuffled(seen, seed), hypotheses=hypotheses)
    torch.testing.assert_close(again.positions, tracks.positions)
    torch.testing.assert_close(same, score)
    soft, other = follow_softly(network, seen), follow_softly(network, shuffled(seen, seed))
    torch.testing.assert_close(other.positions, soft.positions, atol=1e-4, rtol=1e-3)


def test_the_first_frame_names_the_bodies(plain):
    seen = found(curves(1, 6, 3, 0))
    order = torch.tensor([2, 0, 1])
    renamed = Detections(seen.positions[:, :, order], seen.confidence, seen.times)
    tracks, _ = follow(plain, seen)
    again, _ = follow(plain, renamed)
    torch.testing.assert_close(again.positions, tracks.positions[:, :, order])


@pytest.mark.parametrize("n", [2, 3, 5])
def test_curves_are_followed_through_any_order(plain, n):
    truth = curves(20, 8, n, n)
    step = (truth[:, 1] - truth[:, 0]).norm(dim=-1).amax(-1)
    apart = torch.cdist(truth[:, 0], truth[:, 0]) + 1e3 * torch.eye(n)
    clear = apart.amin((-2, -1)) > 2 * step  # else the first step says nothing
    tracks, _ = follow(plain, shuffled(found(truth), 1))
    assert int(clear.sum()) > 5
    torch.testing.assert_close(tracks.positions[clear], truth[clear])


def crossing() -> torch.Tensor:
    """Two bodies that pass each other, the step longer than their distance at the meeting."""
    t = torch.arange(9.0)
    x = torch.stack([0.5 * (t - 3.7), 0.5 * (3.7 - t)], -1)
    y = torch.tensor([0.02, -0.02]).expand(9, 2)
    return torch.stack([x, y], -1).unsqueeze(0)


def nearest(seen: torch.Tensor) -> torch.Tensor:
    """Each frame's detections in the order that keeps them nearest to the last frame's."""
    tracks = seen.clone()
    for frame in range(1, seen.shape[1]):
        orders = [list(p) for p in itertools.permutations(range(seen.shape[2]))]
        moved = [(seen[0, frame, p] - tracks[0, frame - 1]).square().sum() for p in orders]
        tracks[0, frame] = seen[0, frame, orders[int(torch.stack(moved).argmin())]]
    return tracks


@pytest.mark.parametrize("hypotheses", [1, 6])
def test_bodies_that_cross_keep_their_names(plain, hypotheses):
    truth = crossing()
    assert not torch.allclose(nearest(truth), truth)
    tracks, _ = follow(plain, shuffled(found(truth), 0), hypotheses=hypotheses)
    torch.testing.assert_close(tracks.positions, truth)


def test_later_frames_decide_where_the_first_step_misleads(plain):
    t = torch.arange(6.0)[:, None]
    paths = ((0.0, 0.0, 0.5), (0.4, 0.1, -0.5))
    lines = [torch.cat([x + step * t, y + 0 * t], -1) for x, y, step in paths]
    truth = torch.stack(lines, 1).unsqueeze(0)
    at_once, _ = follow(plain, found(truth), hypotheses=1)
    later, _ = follow(plain, found(truth), hypotheses=2)
    assert not torch.allclose(at_once.positions, truth)
    torch.testing.assert_close(later.positions, truth)


def test_a_missing_detection_is_bridged(plain):
    truth = curves(4, 9, 3, 2)
    positions, confidence = truth.clone(), torch.full((4, 9, 3), 0.8)
    positions[:, 5:7, 1], confidence[:, 5:7, 1] = 0.0, 0.0
    tracks, _ = follow(plain, shuffled(found(positions, confidence), 3))
    torch.testing.assert_close(tracks.positions, truth, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(tracks.confidence, confidence)


def test_a_missing_detection_is_bridged_softly(plain):
    truth = curves(4, 9, 2, 5)
    confidence = torch.ones(4, 9, 2)
    confidence[:, 5, 1] = 0.0
    gone = torch.where(confidence.unsqueeze(-1) > 0, truth, 0)
    soft = follow_softly(plain, found(gone, confidence), temperature=0.2)
    # Sinkhorn takes its time where a track could have either slot: a few percent go astray
    apart = (truth[:, :, 0] - truth[:, :, 1]).norm(dim=-1).amax()
    assert float((soft.positions - truth).detach().abs().max()) < 0.04 * float(apart)
    assert float((gone - truth).abs().max()) > 0.3 * float(apart)


@pytest.mark.parametrize("hypotheses", [1, 6])
def test_a_body_that_appears_late_takes_only_what_the_others_leave(plain, hypotheses):
    truth = curves(1, 8, 2, 4)
    positions, confidence = truth.clone(), torch.ones(1, 8, 2)
    positions[0, :3, 1], confidence[0, :3, 1] = 0.0, 0.0
    tracks, _ = follow(plain, shuffled(found(positions, confidence), 0), hypotheses=hypotheses)
    torch.testing.assert_close(tracks.positions[:, :, 0], truth[:, :, 0])
    torch.testing.assert_close(tracks.positions[:, 3:, 1], truth[:, 3:, 1])
    torch.testing.assert_close(tracks.positions[0, :3, 1], truth[0, 3:4, 1].expand(3, 2))
    assert tracks.confidence[0, :, 1].tolist() == [0, 0, 0, 1, 1, 1, 1, 1]


@pytest.mark.parametrize("n", [2, 4])
def test_enumeration_agrees_with_the_hungarian_method(plain, n, monkeypatch):
    seen = found(torch.randn(10, 5, n, 2, generator=rng(n)))
    listed, score = follow(plain, seen, hypotheses=1)
    monkeypatch.setattr(tracker, "ENUMERATED", 0)
    solved, same = follow(plain, seen, hypotheses=1)
    torch.testing.assert_close(listed.positions, solved.positions)
    torch.testing.assert_close(score, same)


def test_more_hypotheses_never_lower_the_score(plain):
    seen = found(0.3 * torch.randn(20, 6, 3, 2, generator=rng(0)))
    scores = [follow(plain, seen, hypotheses=k)[1] for k in (1, 36, 10_000)]
    assert bool((scores[2] >= scores[0] - 1e-4).all())
    assert float((scores[2] - scores[0]).max()) > 0.1
    assert float((scores[2] - scores[1]).min()) > -1e-4


@pytest.mark.parametrize(("clips", "frames", "n"), [(0, 4, 3), (2, 4, 0), (0, 4, 6), (2, 1, 3)])
def test_nothing_to_follow(plain, clips, frames, n):
    seen = found(torch.randn(clips, frames, n, 2, generator=rng(0)))
    tracks, score = follow(plain, seen)
    assert tracks.positions.shape == seen.positions.shape
    assert score.shape == (clips,)
    if frames == 1:
        assert torch.equal(tracks.positions, seen.positions)


@pytest.mark.parametrize(
    ("seen", "hypotheses", "message"),
    [
        (found(torch.zeros(1, 0, 2, 2)), 1, "no frame"),
        (found(torch.zeros(1, 3, 2, 2)), 0, "at least one hypothesis, got 0"),
        (
            Detections(torch.zeros(1, 3, 1, 2), torch.ones(1, 3, 1), torch.tensor([0.0, 1.0, 3.0])),
            1,
            "evenly spaced.*from 1.0 to 2.0 seconds",
        ),
        (found(torch.full((1, 2, 1, 2), math.nan)), 1, "clip 0, frame 0, slot 0 is not finite"),
    ],
)
def test_following_refuses(plain, seen, hypotheses, message):
    with pytest.raises(ValueError, match=message):
        follow(plain, seen, hypotheses=hypotheses)


# learning


def test_gradients_reach_every_layer(plain):
    with torch.no_grad():
        plain.network[-1].weight.normal_(0, 0.1)  # at the start only one path has weight
    soft = follow_softly(plain, found(0.1 * torch.randn(8, 5, 3, 2, generator=rng(0))))
    (soft.positions.diff(n=3, dim=1).square().mean() + soft.variance.mean()).backward()
    for parameter in plain.parameters():
        assert torch.isfinite(parameter.grad).all()
    assert all(float(p.grad.abs().max()) > 0 for p in list(plain.parameters())[:-1])


def test_doubt_has_variance_and_certainty_has_none(plain):
    seen = found(torch.tensor([[[[0.0, 0.0], [0.02, 0.0]], [[0.01, 0.01], [0.01, -0.01]]]]))
    soft = follow_softly(plain, seen)
    torch.testing.assert_close(soft.variance[0, 1], torch.full((2,), 1e-4))
    sure = follow_softly(plain, found(crossing()), temperature=0.1)
    assert float(sure.variance.detach().max()) < 1e-4


def noisy_lines(clips: int, seed: int) -> torch.Tensor:
    """Straight lines through one place, seen with noise: acceleration tells more than jerk."""
    generator = rng(seed)
    t = torch.arange(9.0)[:, None, None]
    velocity = 0.1 * torch.randn(clips, 1, 3, 2, generator=generator)
    meeting = 0.15 * torch.randn(clips, 1, 3, 2, generator=generator)
    noise = 0.02 * torch.randn(clips, 9, 3, 2, generator=generator)
    return meeting + velocity * (t - 5.3) + noise


def switched(network: Tracker, truth: torch.Tensor) -> float:
    """Share of clips whose tracks are not those of the bodies, decided frame by frame."""
    tracks, _ = follow(network, found(truth), hypotheses=1)
    best = relabel(tracks, truth).positions
    return float(((best - truth).norm(dim=-1) > 1e-6).any(-1).any(-1).float().mean())


def test_hindsight_teaches_the_tracker_to_switch_less(plain):
    seen = found(noisy_lines(100, 0))
    smooth, _ = follow(plain, seen, hypotheses=TrackingSettings().teacher)
    teacher = Detections(smooth.positions, smooth.confidence, smooth.times)
    data = windows_of(teacher, Parameters(torch.ones(100), torch.ones(100, 3)), 7)
    test = noisy_lines(200, 1)
    before = switched(plain, test)
    fit(
        plain,
        lambda batch: hindsight_loss(plain, batch.detections),
        data,
        FitSettings(40, 16, 1e-2, clip=1.0),
        0,
    )
    assert switched(plain, test) < 0.7 * before


# with a head


def falling(clips: int, frames: int, seed: int = 0) -> tuple[torch.Tensor, Parameters]:
    """True positions of gravitating bodies, float64."""
    scene = gravity(mass=(1.0, 1.0))
    start, params = scene.sample(clips, rng(seed))
    return scene.simulate(start, params, 40 * (frames - 1), 40).states.q, params


def test_aim_without_force_is_a_straight_line():
    here, there = torch.randn(2, 4, 3, 2, generator=rng(0), dtype=torch.float64)
    params = Parameters(torch.ones(4).double(), torch.full((4, 3), 2.0).double())
    state = aim(ballistic(), here, there, params, 0.01, 8)
    torch.testing.assert_close(state.p, 2 * (there - here) / INTERVAL)


def test_aim_is_the_state_that_the_law_carries_to_the_next_frame():
    q, params = falling(40, 3)
    law = gravity().law
    state = aim(law, q[:, 0], q[:, 1], params, 0.01, 8)
    reached = roll(law, state, params, 1, 0.01, 8).q[:, 0]
    miss = (reached - q[:, 1]).norm(dim=-1)
    assert float(miss.median()) < 1e-6
    assert float(miss.max()) < 0.02


def test_a_law_foresees_encounters_that_extrapolation_does_not():
    q, params = falling(100, 7)
    motion = motion_under(gravity().law, params, 8)
    past = q[:, None, :6]
    error = (motion(past)[:, 0] - q[:, 6]).norm(dim=-1)
    plain = (extrapolate(past)[:, 0] - q[:, 6]).norm(dim=-1)
    assert float(error.square().mean()) < 0.1 * float(plain.square().mean())
    torch.testing.assert_close(motion(past[:, :, :1]), past[:, :, 0])


def test_a_head_that_answers_nan_is_not_asked():
    head = build(HEADS["unstructured"], 3, 0.01)
    head.set_scale(math.nan, math.nan)
    q, params = falling(2, 5)
    past = q[:, None].float()
    motion = motion_under(head, params.map(lambda x: x.float()), 8)
    assert torch.equal(motion(past), extrapolate(past))


@pytest.mark.parametrize("name", ["factored", "unstructured"])
def test_end_to_end_loss_falls_and_reaches_tracker_and_head(name):
    torch.manual_seed(0)
    network, head = Tracker(), build(HEADS[name], 3, 0.01)
    if name == "unstructured":
        head.set_scale(0.01, 0.01)
    q, params = falling(12, 7)
    data = windows_of(shuffled(found(q.float()), 0), params, 7)
    both = torch.nn.ModuleList([network, head])

    def loss(batch):
        soft = follow_softly(network, batch.detections)
        return prediction_loss(head, soft, batch.params, 8)

    everything = data[torch.arange(len(data))]
    before = loss(everything)
    before.backward()
    for part in (network, head):
        sizes = [float(p.grad.abs().max()) for p in part.parameters() if p.grad is not None]
        assert max(sizes) > 0
        assert all(math.isfinite(size) for size in sizes)
    fit(both, loss, data, FitSettings(10, 12, 1e-2, clip=1.0), 0)
    with torch.no_grad():
        assert float(loss(everything)) < 0.7 * float(before)


def test_the_loss_of_true_tracks_under_the_true_law_is_small():
    q, params = falling(50, 7)
    soft = tracker.SoftTracks(q, torch.zeros(50, 7, 3, dtype=q.dtype))
    right = float(prediction_loss(gravity().law, soft, params, 8))
    wrong = float(prediction_loss(gravity().law, soft, params.with_coupling(-1.0), 8))
    swapped = q.clone()
    swapped[:, 4:] = q[:, 4:, [1, 0, 2]]
    soft = tracker.SoftTracks(swapped, soft.variance)
    assert right < 0.1
    assert wrong > 5 * right
    assert float(prediction_loss(gravity().law, soft, params, 8)) > 5 * right


# the rungs

SIZES = PixelSizes(
    clips=12,
    frames=9,
    stride=40,
    image=32,
    perception_steps=3,
    perception_batch=28,
    track_steps=0,
    held_out=4,
)


@pytest.fixture(scope="module")
def clips() -> Clips:
    world = AnonymousWorld(Camera(height=32, width=32))
    return render_clips(gravity(mass=(1.0, 1.0)), world, 12, 9, 40, 0, "train")


def test_the_rungs_are_listed():
    own = {"anonymous-hand": False, "anonymous-tracker": True, "anonymous-tracker-twostage": False}
    variants = {f"{name}-blobs": joint for name, joint in own.items()}
    assert {name: g.joint for name, g in GROUNDINGS.items()} == own | variants
    assert {g.world for g in GROUNDINGS.values()} == {"anonymous"}


OTHER_BLOBS = ("anonymous-hand-blobs", "anonymous-tracker-twostage-blobs")  # as the tracker's


@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=pytest.mark.slow if x in OTHER_BLOBS else ()) for x in GROUNDINGS],
)
def test_every_rung_gives_the_same_tracks_again(name, clips, tmp_path):
    task = FitTask(clips, SIZES, 0, "factored", tmp_path)
    fitted = GROUNDINGS[name].fit(task)
    tracks = fitted.tracks(clips)
    again = GROUNDINGS[name].fit(FitTask(clips, SIZES, 0, "factored"))
    assert torch.equal(again.tracks(clips).positions, tracks.positions)
    error = (relabel(tracks, clips.states.q).positions - clips.states.q).norm(dim=-1)
    # world units; a pixel is 0.25, and what a blob looks like is measured on so coarse a grid
    assert float(error.median()) < (1e-2 if "blobs" in name else 1e-3)


def test_the_hand_made_rung_is_detector_and_binder(clips):
    tracks = GROUNDINGS["anonymous-hand"].fit(FitTask(clips, SIZES, 0, "factored"))
    expected = bind_by_acceleration(detections_of(clips))
    assert torch.equal(tracks.tracks(clips).positions, expected.positions)


def test_the_true_law_keeps_every_name(plain):
    world = AnonymousWorld(Camera(height=32, width=32))
    scene = gravity(mass=(1.0, 1.0))
    many = render_clips(scene, world, 50, 7, 40, 5, "test")

    def lost(tracks: Tracks) -> int:
        apart = relabel(tracks, many.states.q).positions - many.states.q
        return int((apart.norm(dim=-1) > 0.05).flatten(1).any(1).sum())

    by_hand = lost(bind_by_acceleration(detections_of(many)))
    assert by_hand >= 5
    assert lost(LearnedBinding(plain, scene.law).tracks(many)) <= by_hand / 4
    start = many.states[:, -1]
    seen = Seen(many.first(2), many, Question(scene, start, start, many.params))
    perceived = perceive(LearnedBinding(plain), seen)
    assert lost(perceived.under(scene.law)) <= by_hand / 4 < lost(perceived.test)
    momentum = MOMENTUM["shooting"].start(scene.law, perceived).p.double()
    assert int(((momentum - start.p).abs() > 1).flatten(1).any(1).sum()) <= by_hand / 4


def test_a_head_that_foresees_badly_does_no_harm(plain, clips):
    torch.manual_seed(1)
    head = build(HEADS["unstructured"], 3, 0.01)
    head.set_scale(0.2, 5.0)
    alone = LearnedBinding(plain).tracks(clips).positions
    assert torch.equal(LearnedBinding(plain, head).tracks(clips).positions, alone)


def test_detections_are_kept_and_found_again(clips, tmp_path, monkeypatch):
    first = detections_of(clips, tmp_path)
    assert len([*tmp_path.iterdir()]) == 1
    monkeypatch.setattr(detections, "detect", lambda *_: pytest.fail("looked again"))
    again = detections_of(clips, tmp_path)
    assert torch.equal(again.positions, first.positions)
    assert torch.equal(again.confidence, first.confidence)
    slower = replace(clips, interval=2 * clips.interval)
    dimmer = replace(clips, world=replace(clips.world, softness=0.1))
    for other in (clips.until(5), slower, dimmer):
        with pytest.raises(pytest.fail.Exception):
            detections_of(other, tmp_path)


def test_a_detector_does_not_look_again_at_clips_that_it_saw_lately(clips):
    looked = []

    def look(seen):
        looked.append(len(seen))
        return detections_of(seen)

    remembering = detections.Remembering(look)
    first = remembering(clips)
    assert torch.equal(remembering(clips).positions, first.positions)
    assert len(looked) == 1
    other = [clips.first(count) for count in (1, 2, 3, 4)]
    found = [remembering(few) for few in other]
    assert [len(f.positions) for f in found] == [1, 2, 3, 4]
    assert torch.equal(remembering(other[3]).positions, found[3].positions)
    remembering(clips)  # long ago by now
    assert looked == [len(clips), 1, 2, 3, 4, len(clips)]


def test_windows_without_a_body_are_not_learned_from():
    confidence = torch.ones(2, 9, 3)
    confidence[0, 7, 1] = 0.0
    seen = found(torch.randn(2, 9, 3, 2, generator=rng(0)), confidence)
    data = windows_of(seen, Parameters(torch.tensor([1.0, 2.0]), torch.ones(2, 3)), 7)
    assert data.params.coupling.tolist() == [1, 2, 2, 2]
    torch.testing.assert_close(data.detections.positions[0], seen.positions[0, :7])
    torch.testing.assert_close(data.detections.positions[3], seen.positions[1, 2:])


def test_the_rungs_refuse_what_they_cannot_see(clips):
    other = render_clips(gravity(), AnonymousWorld(Camera(height=16, width=16)), 2, 7, 40, 0, "x")
    with pytest.raises(InputError, match="the heavy one"):
        detections_of(other)
    with pytest.raises(InputError, match="clips of 6 frames"):
        GROUNDINGS["anonymous-tracker"].fit(FitTask(clips.until(6), SIZES, 0, "factored"))
    with pytest.raises(InputError, match="no window of 7 frames"):
        windows_of(found(torch.zeros(1, 7, 2, 2), torch.zeros(1, 7, 2)), clips.params[:1], 7)


# evaluation


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 6), st.integers(0, 1000))
def test_relabelling_undoes_any_permutation(n, seed):
    truth = torch.randn(5, 4, n, 2, generator=rng(seed))
    orders = torch.stack([torch.randperm(n, generator=rng(seed + i)) for i in range(5)])
    index = orders[:, None].expand(5, 4, n)
    mixed = truth.gather(2, index.unsqueeze(-1).expand(5, 4, n, 2))
    noise = 0.01 * torch.randn(mixed.shape, generator=rng(seed))
    marks = mixed.sum(-1).sigmoid()
    named = relabel(Tracks(mixed + noise, marks, torch.arange(4.0)), truth.double())
    torch.testing.assert_close(named.positions, truth, atol=0.06, rtol=0)
    torch.testing.assert_close(named.confidence, truth.sum(-1).sigmoid())


def test_relabelling_hides_no_switch():
    truth = torch.tensor([[0.0, 0.0], [1.0, 0.0]]).expand(1, 6, 2, 2)
    tracks = truth.clone()
    tracks[:, 4:] = truth[:, 4:].flip(2)
    named = relabel(Tracks(tracks, torch.ones(1, 6, 2), torch.arange(6.0)), truth)
    # four frames of six agree, but the last frame counts as much as all together
    torch.testing.assert_close(named.positions, tracks.flip(2))
    assert float((named.positions - truth).abs().max()) == 1.0


def test_relabelling_refuses(monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    tracks = Tracks(torch.zeros(1, 2, 2, 2), torch.ones(1, 2, 2), torch.arange(2.0))
    with pytest.raises(ValueError, match=r"\(1, 2, 2, 2\) and the truth is \(1, 3, 2, 2\)"):
        relabel(tracks, torch.zeros(1, 3, 2, 2))
    with pytest.raises(ValueError, match="finite"):
        relabel(tracks, torch.full((1, 2, 2, 2), math.nan))
