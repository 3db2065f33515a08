"""The fixed detector and the hand-made binder: what they find, and what they say of their doubt."""

import itertools
import math

import jaxtyping
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from binders import Detections, bind_by_acceleration, detect, hand
from binders.detect import DetectorSettings
from binders.fit import Light
from renderers import AnonymousWorld, Camera

WORLD = AnonymousWorld()
PIXEL = WORLD.camera.units_per_pixel


def see(q: torch.Tensor, bodies: int, world: AnonymousWorld = WORLD, **options) -> Detections:
    """Detections in the stored (uint8) frames of one clip, positions ``(t, n, 2)``."""
    frames = (world(q) * 255).round() / 255
    return look(frames.unsqueeze(0), bodies, world, **options)


def look(frames, bodies, world=WORLD, **options):
    times = 0.08 * torch.arange(frames.shape[1])
    camera = world.camera
    return detect(frames, times, bodies, world.coverage, camera.xs(), camera.ys(), **options)


def errors(found: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Distance of each true body from the detection that is matched to it, ``(t, n)``."""
    result = torch.empty(truth.shape[:-1])
    for frame, distance in enumerate(torch.cdist(truth.double(), found.double())):
        rows, columns = linear_sum_assignment(distance.square())
        result[frame, rows] = distance[rows, columns].float()
    return result


def scattered(frames: int, bodies: int, seed: int = 0) -> torch.Tensor:
    q = torch.randn(frames, bodies, 2, generator=torch.Generator().manual_seed(seed))
    return q.clamp(-3.6, 3.6)


# the detector


@pytest.mark.parametrize(("bodies", "worst"), [(1, 0.002), (2, 0.005), (3, 0.02), (4, 0.02)])
def test_detector_finds_bodies_that_overlap(bodies, worst):
    truth = scattered(200, bodies)
    seen = see(truth, bodies)
    error = errors(seen.positions[0], truth)
    assert float(error.max()) < worst
    assert float(error.square().mean().sqrt()) < 1e-3
    assert float(seen.confidence.min()) > 0.5


def test_detector_separates_near_coincident_bodies():
    angle = torch.linspace(0, math.pi, 25)
    half = 0.03 * torch.stack([angle.cos(), angle.sin()], dim=-1)
    truth = torch.stack([0.21 + half, 0.21 - half], dim=1)
    seen = see(truth, 2)
    assert float(errors(seen.positions[0], truth).max()) < 5e-3
    apart = see(truth * torch.tensor([[[1.0], [-8.0]]]), 2)
    assert float(seen.confidence.max()) < float(apart.confidence.min())


def test_exactly_coincident_bodies_are_both_found():
    truth = torch.tensor([[[0.4, -0.3], [0.4, -0.3]]])
    seen = see(truth, 2)
    assert float(errors(seen.positions[0], truth).max()) < 0.02
    assert float(seen.confidence.min()) > 0


def test_bodies_that_hide_behind_others_are_found():
    truth = torch.tensor(
        [
            [[0.21, 0.50], [-0.68, -0.44], [0.22, 0.23], [0.07, -0.88]],
            [[0.27, 0.01], [-0.22, 0.27], [0.0, 0.16], [0.27, -0.57]],
            [[0.19, 0.15], [-0.64, -0.78], [0.10, -0.67], [0.18, 0.22]],
            [[0.10, -0.76], [-0.06, 0.76], [0.06, -0.47], [-0.18, 0.84]],
        ]
    )
    assert float(errors(see(truth, 4).positions[0], truth).max()) < 0.01


@pytest.mark.parametrize(
    "camera", [Camera(4.0, 40, 64), Camera(4.0, 32, 32), Camera(4.0, 224, 224)]
)
def test_detector_on_other_cameras(camera):
    truth = scattered(30, 3) / 2
    error = errors(see(truth, 3, AnonymousWorld(camera)).positions[0], truth)
    assert float(error.max()) < 0.02


def test_detector_with_rows_from_the_bottom_up():
    truth = scattered(5, 2)
    frames = WORLD(truth).flip(-2).unsqueeze(0)
    camera = WORLD.camera
    seen = detect(frames, torch.arange(5.0), 2, WORLD.coverage, camera.xs(), camera.ys().flip(0))
    assert float(errors(seen.positions[0], truth).max()) < 0.005


def test_detector_knows_bodies_beyond_the_edge():
    truth = torch.tensor([[[0.3, 0.2], [4.4, -1.0]], [[0.3, 0.2], [-1.0, -4.3]]])
    assert float(errors(see(truth, 2).positions[0], truth).max()) < 0.005


@pytest.mark.parametrize("hidden", [[9.0, 0.0], [0.0, -60.0]])
def test_a_body_out_of_the_frame_has_no_confidence(hidden):
    truth = torch.tensor([[[0.3, 0.2], hidden, [0.5, 0.4]]])
    seen = see(truth, 3)
    confidence, order = seen.confidence[0, 0].sort()
    assert confidence[0] == 0
    assert float(confidence[1]) > 0.9
    assert seen.positions[0, 0, order[0]].abs().sum() == 0
    assert float(errors(seen.positions[:, 0, order[1:]], truth[:, [0, 2]]).max()) < 0.005


@pytest.mark.parametrize("light", [0.0, 1.0])
@pytest.mark.parametrize("size", [(64, 64), (1, 1), (1, 9), (8, 3)])
def test_frames_without_shape_give_finite_answers(light, size):
    world = AnonymousWorld(Camera(4.0, *size))
    seen = look(torch.full((2, 3, 1, *size), light), 2, world)
    assert seen.positions.shape == (2, 3, 2, 2)
    assert torch.isfinite(seen.positions).all()
    assert float(seen.confidence.max()) <= (0.5 if light else 0)


@pytest.mark.parametrize(("clips", "frames", "bodies"), [(1, 2, 0), (0, 2, 3)])
def test_nothing_to_find(clips, frames, bodies):
    seen = look(torch.zeros(clips, frames, 1, 64, 64), bodies)
    assert seen.positions.shape == (clips, frames, bodies, 2)
    assert seen.confidence.shape == (clips, frames, bodies)


def test_light_that_no_body_explains_lowers_confidence():
    truth = scattered(6, 2)
    clean, frames = see(truth, 2), WORLD(truth).unsqueeze(0)
    frames[..., :8] = 1.0
    assert float(look(frames, 2).confidence.max()) < 0.5 * float(clean.confidence.min())


def test_a_frame_is_read_on_its_own():
    truth = scattered(12, 3)
    seen = see(truth, 3)
    backwards = see(truth.flip(0), 3)
    torch.testing.assert_close(backwards.positions, seen.positions.flip(1), rtol=0, atol=1e-4)


def test_noise_that_is_told_does_not_make_bodies():
    told = DetectorSettings(noise=0.06)
    frames = WORLD(scattered(40, 2)).unsqueeze(0)
    noise = 0.05 * torch.randn(frames.shape, generator=torch.Generator().manual_seed(0))
    confidence = look(frames + noise, 3, settings=told).confidence.sort(-1).values
    assert (confidence[..., 0] == 0).all()
    assert float(confidence[..., 1:].min()) > 0.5
    assert (look(noise, 3, settings=told).confidence == 0).all()


@settings(max_examples=10, deadline=None)
@given(st.integers(-6, 6), st.integers(-6, 6), st.integers(0, 1000))
def test_detections_move_with_the_picture(right, up, seed):
    truth = scattered(2, 3, seed) / 2
    shift = PIXEL * torch.tensor([right, up])
    here, there = see(truth, 3).positions[0], see(truth + shift, 3).positions[0]
    assert float(errors(there, here + shift).max()) < 0.01


def test_detector_in_double_precision():
    truth = scattered(4, 2).double()
    camera = WORLD.camera
    frames = WORLD(truth).unsqueeze(0)
    seen = detect(frames, torch.arange(4.0), 2, WORLD.coverage, camera.xs(), camera.ys())
    assert seen.positions.dtype == torch.float64
    assert float(errors(seen.positions[0], truth).max()) < 1e-5


def frames_with(value):
    frames = torch.zeros(2, 3, 1, 64, 64)
    frames[1, 2, 0, 5, 5] = value
    return frames


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": frames_with(math.nan)}, "clip 1, frame 2 has a pixel that is not finite"),
        ({"times": torch.arange(2.0)}, r"must count the frames.*got \(2, 64, 64\)"),
        ({"xs": torch.arange(63.0)}, r"must count the frames.*got \(3, 64, 63\)"),
        ({"frames": torch.zeros(1, 0, 1, 64, 64), "times": torch.zeros(0)}, "at least one of each"),
        ({"xs": torch.arange(64.0)}, "evenly spaced by one distance, got gaps from 0.125"),
        ({"bodies": -1}, "bodies must be at least 0"),
        ({"settings": DetectorSettings(noise=0.0)}, "noise positive, got 3 and 0.0"),
    ],
)
def test_detector_refuses(change, message, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # as it is for users
    camera = WORLD.camera
    arguments = {
        "frames": frames_with(0.0),
        "times": torch.arange(3.0),
        "bodies": 3,
        "coverage": WORLD.coverage,
        "xs": camera.xs(),
        "ys": camera.ys(),
    }
    with pytest.raises(ValueError, match=message):
        detect(**arguments | change)


def test_normal_equations_are_those_of_the_pixels():
    camera = Camera(2.0, 9, 12)
    world = AnonymousWorld(camera, 0.6, 0.2)
    light = Light(world.coverage, camera.xs(torch.float64), camera.ys(torch.float64), 0.8)
    q = torch.tensor([[[0.1, 0.2], [-0.3, 0.3], [0.2, -0.4]]], dtype=torch.float64)
    target = torch.rand(1, 9, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    jacobian = torch.autograd.functional.jacobian(world, q).reshape(9 * 12, 6)
    residual = (target - world(q)[0]).flatten()
    normal = light.normal(q, target)
    torch.testing.assert_close(normal.matrix[0], jacobian.T @ jacobian)
    torch.testing.assert_close(normal.gradient[0], jacobian.T @ residual)
    torch.testing.assert_close(normal.error[0], residual.square().sum())


# the binder


def straight(n: int, frames: int, times: torch.Tensor, seed: int) -> torch.Tensor:
    """Bodies in straight lines through one region, ``(1, t, n, 2)``."""
    generator = torch.Generator().manual_seed(seed)
    start = 3 * torch.randn(n, 2, generator=generator)
    velocity = torch.randn(n, 2, generator=generator)
    return (start + velocity * times[:, None, None]).unsqueeze(0)


def shuffled(truth: torch.Tensor, seed: int) -> torch.Tensor:
    """The same bodies with slots permuted in each frame but the first."""
    generator = torch.Generator().manual_seed(seed)
    out = truth.clone()
    for clip, frame in itertools.product(range(truth.shape[0]), range(1, truth.shape[1])):
        out[clip, frame] = truth[clip, frame, torch.randperm(truth.shape[2], generator=generator)]
    return out


def detections(positions, times=None, confidence=None):
    times = 0.08 * torch.arange(positions.shape[1]) if times is None else times
    confidence = torch.ones(positions.shape[:-1]) if confidence is None else confidence
    return Detections(positions, confidence, times)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 6), st.integers(1, 12), st.integers(0, 10_000), st.booleans())
def test_straight_lines_are_followed_through_any_order(n, frames, seed, uneven):
    gaps = torch.rand(frames, generator=torch.Generator().manual_seed(seed)) + 0.2
    times = 0.02 * (gaps.cumsum(0) if uneven else torch.arange(frames))
    truth = straight(n, frames, times, seed)
    tracks = bind_by_acceleration(detections(shuffled(truth, seed), times))
    first = (truth[:, :1] - truth[:, 1:2]).norm(dim=-1).max() if frames > 1 else 0
    apart = torch.cdist(truth[0, 0], truth[0, 0]).fill_diagonal_(torch.inf).min()
    if apart > 2 * first:  # else the first step, of least displacement, may already swap
        torch.testing.assert_close(tracks.positions, truth)


def test_bodies_that_cross_keep_their_names():
    times = torch.arange(9.0)
    x = torch.stack([times - 4, 4 - times], dim=-1)
    truth = torch.stack([x, torch.tensor([0.1, -0.1]).expand(9, 2)], dim=-1).unsqueeze(0)
    tracks = bind_by_acceleration(detections(shuffled(truth, 1), times))
    torch.testing.assert_close(tracks.positions, truth)


def test_the_first_step_is_matched_by_least_displacement():
    positions = torch.tensor([[[[0.0, 0.0], [1.0, 0.0]], [[0.9, 0.0], [0.3, 0.0]]]])
    tracks = bind_by_acceleration(detections(positions))
    torch.testing.assert_close(tracks.positions[0, 1], positions[0, 1].flip(0))


def test_the_choice_is_of_least_squared_second_difference():
    generator = torch.Generator().manual_seed(0)
    positions = torch.randn(50, 3, 3, 2, generator=generator)
    tracks = bind_by_acceleration(detections(positions)).positions
    for clip in range(50):
        guess = 2 * tracks[clip, 1] - tracks[clip, 0]
        costs = [
            float((positions[clip, 2, list(p)] - guess).square().sum())
            for p in itertools.permutations(range(3))
        ]
        assert float((tracks[clip, 2] - guess).square().sum()) == pytest.approx(min(costs))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_enumeration_agrees_with_the_hungarian_method(n, monkeypatch):
    generator = torch.Generator().manual_seed(n)
    positions = torch.randn(20, 6, n, 2, generator=generator)
    confidence = (torch.rand(20, 6, n, generator=generator) > 0.2).float()
    confidence[:, 0] = 1.0  # bodies never seen are alike: which takes what is then arbitrary
    listed = bind_by_acceleration(detections(positions, confidence=confidence))
    monkeypatch.setattr(hand, "ENUMERATED", 0)
    solved = bind_by_acceleration(detections(positions, confidence=confidence))
    torch.testing.assert_close(listed.positions, solved.positions)
    torch.testing.assert_close(listed.confidence, solved.confidence)


def test_an_unseen_body_goes_on_at_constant_velocity():
    times = 0.1 * torch.arange(8)
    truth = straight(3, 8, times, 3)
    positions, confidence = truth.clone(), torch.full((1, 8, 3), 0.9)
    positions[0, 3:6, 1], confidence[0, 3:6, 1] = 0.0, 0.0
    order = [2, 0, 1]
    positions[:, 1:], confidence[:, 1:] = positions[:, 1:, order], confidence[:, 1:, order]
    tracks = bind_by_acceleration(detections(positions, times, confidence))
    torch.testing.assert_close(tracks.positions, truth)
    assert (tracks.confidence[0, 3:6, 1] == 0).all()
    assert (tracks.confidence == 0).sum() == 3


def test_velocity_after_a_gap_spans_the_gap():
    x = torch.tensor([0.0, 1.0, 0.0, 0.0, 7.0, 0.0])
    positions = torch.stack([x, torch.zeros(6)], dim=-1).reshape(1, 6, 1, 2)
    confidence = torch.tensor([1.0, 1.0, 0.0, 0.0, 1.0, 0.0]).reshape(1, 6, 1)
    tracks = bind_by_acceleration(detections(positions, torch.arange(6.0), confidence))
    torch.testing.assert_close(
        tracks.positions[0, :, 0, 0], torch.tensor([0.0, 1.0, 2.0, 3.0, 7.0, 9.0])
    )


def test_a_body_that_appears_late_takes_only_what_the_others_leave():
    times = 0.1 * torch.arange(6)
    truth = straight(2, 6, times, 5)
    positions, confidence = truth.clone(), torch.ones(1, 6, 2)
    positions[0, :3, 1], confidence[0, :3, 1] = 0.0, 0.0
    positions[:, 1:], confidence[:, 1:] = positions[:, 1:].flip(2), confidence[:, 1:].flip(2)
    tracks = bind_by_acceleration(detections(positions, times, confidence))
    torch.testing.assert_close(tracks.positions[:, :, 0], truth[:, :, 0])
    torch.testing.assert_close(tracks.positions[:, 3:, 1], truth[:, 3:, 1])
    assert tracks.positions[0, :3, 1].abs().sum() == 0
    assert tracks.confidence[0, :, 1].tolist() == [0, 0, 0, 1, 1, 1]


def test_a_body_that_appears_late_is_followed_from_then_on():
    x = torch.tensor([[0.0, 0.0, 5.0, 6.0, 0.0, 8.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]])
    seen = torch.tensor([[0.0, 0.0, 1.0, 1.0, 0.0, 1.0], [1.0] * 6])
    positions = torch.stack([x.T, torch.zeros(6, 2)], dim=-1).unsqueeze(0)
    tracks = bind_by_acceleration(detections(positions, torch.arange(6.0), seen.T.unsqueeze(0)))
    assert tracks.positions[0, :, 0, 0].tolist() == [0, 0, 5, 6, 7, 8]
    assert tracks.positions[0, :, 1, 0].tolist() == [0, 1, 2, 3, 4, 5]


def test_confidence_travels_with_its_detection():
    truth = straight(3, 5, 0.02 * torch.arange(5), 0)
    marks = truth.sum(-1).sigmoid()
    both = shuffled(torch.cat([truth, marks.unsqueeze(-1)], -1), 2)
    tracks = bind_by_acceleration(detections(both[..., :2], confidence=both[..., 2]))
    torch.testing.assert_close(tracks.confidence, tracks.positions.sum(-1).sigmoid())


@pytest.mark.parametrize("n", [0, 1, 3, 6])
def test_a_clip_of_one_frame_keeps_its_order(n):
    seen = detections(torch.randn(4, 1, n, 2, generator=torch.Generator().manual_seed(0)))
    tracks = bind_by_acceleration(seen)
    assert torch.equal(tracks.positions, seen.positions)
    assert torch.equal(tracks.confidence, seen.confidence)


@pytest.mark.parametrize(("clips", "n"), [(0, 3), (2, 0), (0, 6)])
def test_nothing_to_follow(clips, n):
    tracks = bind_by_acceleration(detections(torch.zeros(clips, 4, n, 2)))
    assert tracks.positions.shape == (clips, 4, n, 2)


@settings(max_examples=15, deadline=None)
@given(st.integers(2, 6), st.floats(-5, 5), st.integers(0, 1000))
def test_tracks_move_with_their_detections_and_clips_are_independent(n, shift, seed):
    generator = torch.Generator().manual_seed(seed)
    positions = torch.randn(3, 5, n, 2, generator=generator, dtype=torch.float64)
    tracks = bind_by_acceleration(detections(positions)).positions
    moved = bind_by_acceleration(detections(positions + shift)).positions
    torch.testing.assert_close(moved, tracks + shift)
    alone = bind_by_acceleration(detections(positions[1:2])).positions
    torch.testing.assert_close(alone, tracks[1:2])


def test_gradients_flow_through_the_chosen_positions():
    positions = shuffled(straight(3, 4, 0.02 * torch.arange(4), 1), 1).requires_grad_()
    bind_by_acceleration(detections(positions)).positions.sum().backward()
    torch.testing.assert_close(positions.grad, torch.ones_like(positions))


@pytest.mark.parametrize(
    ("seen", "message"),
    [
        (detections(torch.zeros(1, 0, 2, 2)), "have no frame"),
        (detections(torch.zeros(1, 2, 2, 2), torch.zeros(2)), "must rise"),
        (detections(torch.full((1, 1, 2, 2), math.nan)), "clip 0, frame 0, slot 0 is not finite"),
        (
            detections(torch.zeros(1, 1, 2, 2), confidence=torch.tensor([[[1.0, math.inf]]])),
            "slot 1 is not finite",
        ),
    ],
)
def test_binder_refuses(seen, message):
    with pytest.raises(ValueError, match=message):
        bind_by_acceleration(seen)
