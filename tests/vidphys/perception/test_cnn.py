"""The rungs of the channel world: what each reaches at a tiny size, and what it may look at."""

import os
import signal
from dataclasses import replace

import pytest
import torch

from dynamics import HEADS, PhaseState, build
from dynamics.unstructured import ResidualMap
from renderers import AnonymousWorld, Camera, ChannelWorld
from vidphys.data.clips import Clips, render_clips
from vidphys.errors import InputError
from vidphys.perception import discovered, jepa, synthesis
from vidphys.perception.base import FitTask
from vidphys.perception.channel_groundings import CHANNEL_GROUNDINGS
from vidphys.perception.cnn import CnnPerception, fit_supervised
from vidphys.perception.discovered import (
    Discovery,
    DiscoverySettings,
    blur_matrices,
    fit_discovered,
)
from vidphys.perception.jepa import Jepa, JepaPerception, fit_jepa, fit_jepa_centroid
from vidphys.perception.windows import FrameBatches, WindowBatches, steps_per_frame
from vidphys.presets import PixelSizes
from vidphys.scenes import gravity
from vidphys.shooting.step import HEAD_DT

EVERY = 8
CAMERA = Camera(4.0, 32, 32)
SIZES = PixelSizes(24, 8, 40, 32, 60, 16, 0, 8)


@pytest.fixture(scope="module")
def clips() -> Clips:
    return render_clips(gravity(), ChannelWorld(CAMERA), SIZES.clips, SIZES.frames, 40, 0, "train")


@pytest.fixture(scope="module")
def unseen() -> Clips:
    return render_clips(gravity(), ChannelWorld(CAMERA), 8, 7, 40, 0, "test")


def blind(clips: Clips) -> Clips:
    """The same clips without the truth."""
    return replace(clips, states=clips.states.map(lambda x: torch.full_like(x, torch.nan)))


def task(clips: Clips, head: str = "factored", steps: int = SIZES.perception_steps) -> FitTask:
    return FitTask(clips, replace(SIZES, perception_steps=steps), 0, head)


def rmse(tracks, clips: Clips) -> float:
    return float((tracks.positions - clips.states.q).square().mean().sqrt())


def spread(clips: Clips) -> float:
    return float(clips.states.q.std())


# --- what is cut from clips ---


def test_windows_are_the_frames_of_one_clip_in_order(clips):
    windows = WindowBatches(clips, 5, clips.states.q)
    assert len(windows) == len(clips) * 4
    window = windows[torch.tensor([0, 3, 4, 95])]
    for row, (clip, first) in enumerate([(0, 0), (0, 3), (1, 0), (23, 3)]):
        frames = clips.frames[clip, first : first + 5].float() / 255
        assert torch.equal(window.frames[row], frames)
        assert torch.equal(window.targets[row], clips.states.q[clip, first : first + 5])
        assert window.params.coupling[row] == clips.params.coupling[clip].float()


def test_frame_batches_pair_frames_with_targets(clips):
    data = FrameBatches(clips.frames.flatten(0, 1), clips.states.q.flatten(0, 1))
    images, targets = data[torch.tensor([9])]
    assert images.shape == (1, 1, 3, 32, 32) and images.max() <= 1
    assert torch.equal(images[0, 0], clips.images()[1, 1])
    assert torch.equal(targets[0], clips.states.q[1, 1])


def test_short_clips_and_odd_intervals_are_refused(clips):
    with pytest.raises(InputError, match="windows of 6"):
        WindowBatches(clips.until(5), 6)
    assert steps_per_frame(clips) == EVERY
    with pytest.raises(InputError, match="multiple of the head's step"):
        steps_per_frame(replace(clips, interval=0.0133))


# --- renderer ---


def test_synthesis_is_exact_to_the_rounding_of_bytes(unseen):
    fitted = synthesis.fit_synthesis(task(blind(unseen)))
    tracks = fitted.tracks(blind(unseen))
    assert rmse(tracks, unseen) < 0.0005
    assert tracks.confidence.min() > 0.999


def test_synthesis_at_the_edge_of_the_frame_and_of_nothing():
    world = ChannelWorld(CAMERA)
    q = torch.tensor([[[3.9, -3.7], [0.0, 4.1]], [[-4.2, 1.0], [9.0, 9.0]]])
    frames = world(q)
    found, confidence = synthesis.fit_positions(world, frames)
    assert (found - q)[0].abs().max() < 1e-3 and (found - q)[1, 0].abs().max() < 1e-3
    assert confidence[1, 1] == 0 and torch.equal(found[1, 1], torch.zeros(2))
    assert confidence[0].min() > 0.999


def test_synthesis_does_not_trust_what_it_cannot_draw():
    world = ChannelWorld(CAMERA)
    two = world(torch.tensor([[1.0, 0.0], [-1.0, 0.0]])).sum(0, keepdim=True)
    _, confidence = synthesis.fit_positions(world, two)
    assert confidence.item() < 0.7


@pytest.mark.parametrize("bright", [0.3, 1.0])
def test_confidence_is_the_share_of_the_light_that_is_explained(bright):
    world = ChannelWorld(CAMERA)
    frames = bright * world(torch.tensor([[1.0, 0.0], [-1.0, 0.0]])).sum(0, keepdim=True)
    found, confidence = synthesis.fit_positions(world, frames)
    left = (world(found) - frames).square().sum() / frames.square().sum()
    assert confidence.item() == pytest.approx(max(0.0, 1 - left.item()), abs=1e-5)


# --- supervised ---


def test_supervised_training_finds_bodies(clips, unseen):
    fitted = fit_supervised(task(clips, steps=80))
    assert not fitted.training
    assert rmse(fitted.tracks(unseen), unseen) < 0.05 * spread(unseen)


def test_tracks_do_not_depend_on_the_batch_and_can_be_trained_on(unseen):
    perception = CnnPerception(3, 3, CAMERA).eval()
    whole = perception.tracks(unseen)
    alone = perception.tracks(
        replace(
            unseen,
            frames=unseen.frames[5:6],
            states=unseen.states[5:6],
            params=unseen.params[5:6],
        )
    )
    assert torch.allclose(whole.positions[5:6], alone.positions, atol=1e-5)
    assert torch.equal(perception.tracks(unseen).positions, whole.positions)
    assert whole.positions.dtype == torch.float64
    scale = torch.ones((), dtype=torch.float64, requires_grad=True)
    (scale * whole.positions).square().sum().backward()  # not an inference tensor
    assert scale.grad is not None


def test_another_camera_is_refused(unseen):
    perception = CnnPerception(3, 3, Camera(5.0, 32, 32))
    with pytest.raises(InputError, match="camera"):
        perception.tracks(unseen)


def test_fitting_again_from_the_folder_takes_no_steps(clips, unseen, tmp_path):
    taken = []
    first = replace(
        task(clips, steps=4), folder=tmp_path, progress=lambda *step: taken.append(step)
    )
    a = fit_supervised(first).tracks(unseen)
    assert len(taken) == 4
    b = fit_supervised(first).tracks(unseen)
    assert len(taken) == 4
    assert torch.equal(a.positions, b.positions)


# --- discovered ---


def discovery(head: str = "factored", steps: int = 10) -> Discovery:
    torch.manual_seed(1)
    return Discovery(
        CnnPerception(3, 3, CAMERA),
        build(HEADS[head], 3, HEAD_DT),
        ChannelWorld(CAMERA),
        EVERY,
        steps,
    )


def test_the_blur_ends_sharp_and_keeps_light_inside(clips):
    settings = DiscoverySettings()
    assert settings.blur(0.0) == settings.first_blur
    assert settings.blur(settings.sharp_from) == settings.blur(1.0) == 0
    rows, columns = blur_matrices(Camera(4.0, 32, 48), 0.0)
    assert torch.equal(rows, torch.eye(32)) and torch.equal(columns, torch.eye(48))
    rows, _ = blur_matrices(Camera(2.0, 32, 32), 0.3)
    impulse = torch.zeros(32)
    impulse[16] = 1
    light = rows @ impulse
    at = torch.arange(32) * 4.0 / 32
    assert light.sum() == pytest.approx(1, abs=1e-4)
    assert ((at - at[16]).square() * light).sum().sqrt() == pytest.approx(0.3, rel=0.01)


def test_true_positions_and_the_true_law_leave_no_loss(clips):
    """The loss is that of the prediction: with nothing to learn it is near zero, else not."""

    class Oracle(torch.nn.Module):
        def __init__(self, shift: float) -> None:
            super().__init__()
            self.shift = shift

        def locate(self, frames):
            return windows.targets[:, : frames.shape[1]].float() + self.shift

    windows = WindowBatches(clips, 5, clips.states.q)[torch.arange(20)]
    parts = discovery()
    parts.step += 10  # sharp
    parts.head = gravity().law
    losses = {}
    for shift in (0.0, 0.5):
        parts.perception = Oracle(shift)
        losses[shift] = float(parts.loss(windows))
    assert losses[0.0] < 0.02 < 0.5 < losses[0.5]


@pytest.mark.parametrize("head", ["factored", "unstructured"])
def test_prediction_trains_encoder_and_head(clips, head):
    parts = discovery(head)
    parts.loss(WindowBatches(blind(clips), 5)[torch.arange(4)]).backward()
    reached = {
        name.split(".")[0]
        for name, p in parts.named_parameters()
        if p.grad is not None and bool(p.grad.abs().max() > 0)
    }
    assert reached == {"perception", "head"}


@pytest.mark.slow
def test_bodies_are_discovered_without_a_label(clips, unseen):
    losses = []
    blind_task = replace(task(blind(clips), steps=80), progress=lambda *s: losses.append(s[2]))
    fitted = fit_discovered(blind_task)
    assert rmse(fitted.tracks(blind(unseen)), unseen) < 0.1 * spread(unseen)
    assert losses[-1] < 0.5 * losses[0]


def test_a_residual_map_is_told_the_size_of_a_step(clips):
    head = discovered.new_head(task(clips, "unstructured"), "x")
    assert isinstance(head, ResidualMap)
    assert torch.allclose(head.scale, torch.full((2,), HEAD_DT))


def test_an_interrupted_fit_ends_as_if_it_had_not_been(clips, tmp_path):
    """Blur, batches, weights and optimiser all go on where they were."""

    def interrupt(step: int, steps: int, loss: float) -> None:
        if step == 3:
            os.kill(os.getpid(), signal.SIGINT)

    whole = fit_discovered(task(clips, steps=6))
    stopped = replace(task(clips, steps=6), folder=tmp_path, progress=interrupt)
    with pytest.raises(KeyboardInterrupt):
        fit_discovered(stopped)
    resumed = fit_discovered(replace(stopped, progress=None))
    for a, b in zip(
        whole.state_dict().values(),
        resumed.state_dict().values(),
        strict=True,
    ):
        assert torch.equal(a, b)


@pytest.mark.parametrize("fit", [fit_discovered, synthesis.fit_synthesis])
def test_worlds_without_channels_are_refused(clips, fit):
    anonymous = replace(clips, world=AnonymousWorld(CAMERA), frames=clips.frames[:, :, :1])
    with pytest.raises(InputError, match="channel"):
        fit(task(anonymous)).tracks(anonymous)


# --- JEPA ---


def network(head: str = "factored") -> Jepa:
    torch.manual_seed(1)
    return Jepa(JepaPerception(3, 3, CAMERA), build(HEADS[head], 3, HEAD_DT), EVERY, 10)


@pytest.mark.parametrize("head", ["factored", "unstructured"])
def test_the_target_moves_without_a_gradient(clips, head):
    parts, data = network(head), WindowBatches(blind(clips), 6)
    parts.loss(data[torch.arange(4)]).backward()
    assert all(p.grad is None for p in parts.target.parameters())
    for part in (parts.perception, parts.head):
        assert any(p.grad is not None and bool(p.grad.abs().max() > 0) for p in part.parameters())
    with torch.no_grad():
        for p in parts.perception.parameters():
            p -= 0.01 * torch.ones_like(p)
    before = [p.clone() for p in parts.target.module.parameters()]
    parts.loss(data[torch.arange(4)])
    assert all(
        not torch.equal(a, b) for a, b in zip(before, parts.target.module.parameters(), strict=True)
    )


def test_latents_of_the_future_are_at_the_predicted_frames(clips):
    windows = WindowBatches(clips, 6, clips.states.q.float())[torch.arange(10)]
    parts = network()
    parts.target.module.locate = lambda frames: windows.targets[:, -frames.shape[1] :]
    latents = parts.future_latents(windows)
    assert torch.equal(latents.q, windows.targets[:, 3:5])
    mass = windows.params.mass[:, None, :, None]
    expected = mass * (windows.targets[:, 4:6] - windows.targets[:, 2:4]) / 0.16
    assert torch.allclose(latents.p, expected, rtol=1e-4, atol=1e-4)


def test_momenta_count_as_lengths():
    zero = PhaseState(torch.zeros(1, 1, 2), torch.zeros(1, 1, 2))
    one = PhaseState(torch.zeros(1, 1, 2), torch.ones(1, 1, 2))
    assert jepa.distance(one, zero, 0.08) == pytest.approx(0.08**2)
    assert jepa.distance(PhaseState(one.p, zero.p), zero, 0.08) == pytest.approx(1)


def test_light_anchors_a_jepa_without_a_label(clips, unseen):
    losses = []
    blind_task = replace(task(blind(clips), steps=80), progress=lambda *s: losses.append(s[2]))
    fitted = fit_jepa_centroid(blind_task)
    assert rmse(fitted.tracks(blind(unseen)), unseen) < 0.1 * spread(unseen)
    assert fitted.variance_floor > 0.1
    assert losses[-1] < 0.1 * losses[0]


@pytest.mark.slow
def test_without_an_anchor_the_latent_says_nothing(clips, unseen):
    """The study's negative result, and that the monitor sees it."""
    fitted = fit_jepa(task(blind(clips), steps=40))
    assert fitted.variance_floor < 1e-2
    assert rmse(fitted.tracks(unseen), unseen) > 0.5 * spread(unseen)


def test_light_centres_are_the_positions(clips):
    error = jepa.light_centres(clips) - clips.states.q
    assert error.square().mean().sqrt() < 0.005


# --- the list ---


def test_the_rungs_are_named_once_and_joint_ones_return_their_head(clips):
    names = [g.name for g in CHANNEL_GROUNDINGS]
    assert names == [
        "renderer",
        "cnn-supervised",
        "cnn-discovered",
        "jepa",
        "jepa-centroid",
        "jepa-exact",
    ]
    for grounding in CHANNEL_GROUNDINGS:
        fitted = grounding.fit(task(clips, "factored-radial", steps=1))
        assert fitted.tracks(clips).positions.shape == clips.states.q.shape
