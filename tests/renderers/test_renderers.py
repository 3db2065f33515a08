"""Camera, splats, worlds and centroid: values, gradients, and the edges of what can be drawn."""

import math

import jaxtyping
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd import gradcheck, gradgradcheck

from renderers import (
    PALETTE,
    WORLDS,
    AnonymousWorld,
    Camera,
    ChannelWorld,
    RgbWorld,
    centroids,
    disk_coverage,
    disks,
    gaussian_sum,
    gaussians,
    supersampled,
)
from tests.shared.card import a_card

SMALL = Camera(half_extent=1.5, height=5, width=7)
coordinate = st.floats(-3.0, 3.0, allow_nan=False, width=32)
body = st.tuples(coordinate, coordinate)


def world_of(name: str, camera: Camera):
    return WORLDS[name](camera)


def some_centres(camera: Camera = SMALL) -> torch.Tensor:
    """Two coincident bodies on a pixel's centre, one between pixels, one out of the frame."""
    on = [float(camera.xs(torch.float64)[2]), float(camera.ys(torch.float64)[1])]
    return torch.tensor([on, on, [0.13, -0.41], [2.0, 0.3]], dtype=torch.float64)


# camera


def test_pixel_centres_have_y_up_and_half_a_pixel_of_border():
    camera = Camera(half_extent=4.0, height=32, width=64)
    assert camera.units_per_pixel == 0.125
    torch.testing.assert_close(
        camera.xs()[[0, -1]], torch.tensor([-3.9375, 3.9375]), rtol=1e-6, atol=1e-6
    )
    torch.testing.assert_close(
        camera.ys()[[0, -1]], torch.tensor([1.9375, -1.9375]), rtol=1e-6, atol=1e-6
    )


def test_the_longer_side_spans_the_extent():
    assert Camera(4.0, 64, 16).units_per_pixel == Camera(4.0, 16, 64).units_per_pixel == 0.125


def test_pixel_coordinates_are_the_indices_of_the_grid():
    x, y = SMALL.xs(torch.float64)[5], SMALL.ys(torch.float64)[1]
    pixel = SMALL.to_pixel(torch.stack([x, y]))
    torch.testing.assert_close(
        pixel, torch.tensor([5.0, 1.0], dtype=torch.float64), rtol=3e-15, atol=3e-15
    )


@given(body, st.integers(1, 300), st.integers(1, 300), st.floats(1e-3, 1e3))
def test_world_to_pixel_and_back(position, height, width, half_extent):
    camera = Camera(half_extent, height, width)
    there = torch.tensor(position, dtype=torch.float64)
    torch.testing.assert_close(
        camera.to_world(camera.to_pixel(there)), there, rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 4, 4), "half_extent must be a positive"),
        ((math.nan, 4, 4), "half_extent must be a positive"),
        ((math.inf, 4, 4), "half_extent must be a positive"),
        ((1.0, 0, 4), "at least 1 pixel, got 0 x 4"),
        ((1.0, 4, -1), "at least 1 pixel, got 4 x -1"),
    ],
)
def test_impossible_camera_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Camera(*arguments)


# splats


def test_gaussians_equal_the_plain_formula():
    q = some_centres().reshape(2, 2, 2)
    dx = SMALL.xs(torch.float64) - q[..., None, None, 0]
    dy = SMALL.ys(torch.float64)[:, None] - q[..., None, None, 1]
    expected = torch.exp(-(dx**2 + dy**2) / (2 * 0.3**2))
    images = gaussians(q, SMALL, 0.3)
    torch.testing.assert_close(images, expected, rtol=1e-14, atol=3e-15)
    assert images[0, 0, 1, 2] == 1


def test_gaussian_sum_is_the_weighted_sum_of_gaussians():
    q = some_centres().reshape(2, 2, 2)
    weights = torch.tensor([[1.0, -0.5], [2.0, 0.0]], dtype=torch.float64)
    expected = (weights[..., None, None] * gaussians(q, SMALL, 0.3)).sum(-3)
    torch.testing.assert_close(
        gaussian_sum(q, weights, SMALL, 0.3), expected, rtol=3e-15, atol=3e-15
    )


def test_disk_coverage_is_half_at_the_radius_with_the_slope_of_its_softness():
    r = torch.tensor(0.6, dtype=torch.float64, requires_grad=True)
    coverage = disk_coverage(r**2, 0.6, 0.05)
    (slope,) = torch.autograd.grad(coverage, r)
    assert coverage.item() == pytest.approx(0.5, rel=3e-15)
    assert float(slope) == pytest.approx(-1 / (4 * 0.05), rel=3e-15)


def test_disk_has_the_area_of_a_disk():
    image = disks(torch.tensor([[0.31, -0.17]], dtype=torch.float64), Camera(), 0.6, 0.05)
    width = 2 * 0.6 * 0.05
    area = math.pi * width * math.log1p(math.exp(0.6**2 / width))
    assert float(image.sum()) * 0.125**2 == pytest.approx(area, rel=1e-3)


@pytest.mark.parametrize("check", [gradcheck, gradgradcheck])
@pytest.mark.parametrize(
    "draw",
    [
        lambda q: gaussians(q, SMALL, 0.4),
        lambda q: gaussian_sum(q, q[..., 0], SMALL, 0.4),
        lambda q: disks(q, SMALL, 0.5, 0.2),
        AnonymousWorld(SMALL, 0.5, 0.2),
        RgbWorld(SMALL, 0.5, 0.2),
        ChannelWorld(SMALL, 0.4),
    ],
    ids=["gaussians", "gaussian_sum", "disks", "anonymous", "rgb", "channel"],
)
def test_gradients(draw, check):
    assert check(draw, (some_centres().requires_grad_(),))


@pytest.mark.parametrize("name", WORLDS)
def test_gradient_is_finite_for_saturated_coincident_bodies(name):
    q = torch.zeros(3, 2, requires_grad=True)
    world = WORLDS[name](Camera(1.0, 9, 9))
    if name != "channel":
        world = type(world)(world.camera, radius=0.5, softness=1e-3)
    world(q).sum().backward()
    assert torch.isfinite(q.grad).all()


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda q: gaussians(q, SMALL, 0.0), "sigma must be a positive length"),
        (lambda q: gaussian_sum(q, q[..., 0], SMALL, math.nan), "sigma must be a positive length"),
        (lambda q: disks(q, SMALL, -1.0, 0.1), "radius must be a positive length"),
        (lambda q: disks(q, SMALL, 1.0, math.inf), "softness must be a positive length"),
    ],
)
def test_impossible_sizes_are_refused(draw, message):
    with pytest.raises(ValueError, match=message):
        draw(some_centres())


# worlds


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("camera", [SMALL, Camera(2.0, 1, 1), Camera(2.0, 6, 2)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_world_shapes(name, batch, camera, dtype):
    channels = {"channel": 2, "rgb": 3, "anonymous": 1}[name]
    frames = world_of(name, camera)(torch.zeros(*batch, 2, 2, dtype=dtype))
    assert frames.shape == (*batch, channels, camera.height, camera.width)
    assert frames.dtype == dtype


@pytest.mark.parametrize("name", WORLDS)
def test_no_bodies_give_black_frames(name):
    frames = world_of(name, SMALL)(torch.zeros(2, 0, 2))
    assert frames.shape == (2, {"channel": 0, "rgb": 3, "anonymous": 1}[name], 5, 7)
    assert frames.abs().sum() == 0


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("far", [20.0, -1e4, 1e18])
def test_bodies_out_of_the_frame_leave_nothing(name, far):
    assert world_of(name, SMALL)(torch.full((2, 2), far)).max() < 3e-15


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_named(name, bad):
    q = torch.zeros(2, 3, 2)
    q[1, 2, 0] = bad
    with pytest.raises(ValueError, match=r"body 2 at batch index \(1,\) is not finite"):
        world_of(name, SMALL)(q)


@pytest.mark.parametrize("draw", [gaussians, disks, gaussian_sum])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_on_a_card_a_position_that_is_not_finite_is_seen_and_not_waited_for(draw, bad):
    """Asking for a number of the card would wait for all that it is still computing."""
    q = torch.zeros(2, 3, 2)
    q[1, 2, 0] = bad
    sizes = {gaussians: (0.5,), disks: (0.5, 0.1), gaussian_sum: (0.5,)}[draw]
    with a_card():
        weights = [torch.ones(2, 3, device="cuda")] if draw is gaussian_sum else []
        q, graph = q.to("cuda"), torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            frames = draw(q, *weights, SMALL, *sizes)
        wrong = frames.isnan().flatten(frames.dim() - 2).any(-1).nonzero().cpu().tolist()
    assert wrong == ([[1]] if draw is gaussian_sum else [[1, 2]])


@pytest.mark.parametrize("name", WORLDS)
@settings(max_examples=25, deadline=None)
@given(bodies=st.lists(body, min_size=1, max_size=4))
def test_frames_stay_in_range(name, bodies):
    frames = world_of(name, Camera(2.0, 9, 12))(torch.tensor(bodies))
    assert float(frames.min()) >= 0
    assert float(frames.max()) <= 1


@pytest.mark.parametrize("name", WORLDS)
@settings(max_examples=15, deadline=None)
@given(bodies=st.lists(body, min_size=3, max_size=3), right=st.integers(0, 5), up=st.integers(0, 5))
def test_moving_by_whole_pixels_moves_the_picture(name, bodies, right, up):
    camera = Camera(4.0, 16, 16)
    q = torch.tensor(bodies, dtype=torch.float64)
    world = world_of(name, camera)
    before = world(q)
    after = world(q + camera.units_per_pixel * torch.tensor([right, up], dtype=torch.float64))
    torch.testing.assert_close(
        after[..., : 16 - up, right:], before[..., up:, : 16 - right], rtol=3e-15, atol=3e-15
    )


@settings(max_examples=20, deadline=None)
@given(bodies=st.lists(body, min_size=3, max_size=3), order=st.permutations(range(3)))
def test_renaming_bodies(bodies, order):
    q = torch.tensor(bodies, dtype=torch.float64)
    channel, anonymous = ChannelWorld(SMALL), AnonymousWorld(SMALL)
    torch.testing.assert_close(channel(q[order]), channel(q)[order], rtol=3e-15, atol=3e-15)
    torch.testing.assert_close(anonymous(q[order]), anonymous(q), rtol=3e-15, atol=3e-15)


@pytest.mark.parametrize("name", WORLDS)
def test_a_batch_is_its_clips(name):
    q = torch.randn(3, 2, 2, 2, generator=torch.Generator().manual_seed(0))
    world = world_of(name, SMALL)
    torch.testing.assert_close(
        world(q), torch.stack([world(clip) for clip in q]), rtol=1e-6, atol=1e-6
    )


def test_overlapping_light_in_the_anonymous_world():
    q = torch.zeros(2, 2, dtype=torch.float64)
    one = AnonymousWorld(SMALL)(q[:1])
    torch.testing.assert_close(AnonymousWorld(SMALL)(q), 1 - (1 - one) ** 2, rtol=3e-15, atol=3e-15)


def test_coverage_is_the_frame_of_one_body():
    world = AnonymousWorld(SMALL)
    x, y = SMALL.xs(), SMALL.ys()
    expected = world.coverage((x - 0.2) ** 2 + (y[:, None] + 0.3) ** 2)
    torch.testing.assert_close(
        world(torch.tensor([[0.2, -0.3]]))[0], expected, rtol=1e-6, atol=1e-6
    )


def test_nearer_bodies_hide_farther_ones():
    world = RgbWorld(Camera(1.0, 9, 9), radius=0.5)
    q = torch.zeros(2, 2, dtype=torch.float64)
    a = float(disks(q[:1], world.camera, 0.5, 0.05)[0, 4, 4])
    first, second = (torch.tensor(c, dtype=torch.float64) for c in PALETTE[:2])
    torch.testing.assert_close(
        world(q)[:, 4, 4], a * first + (1 - a) * a * second, rtol=3e-15, atol=3e-15
    )


def test_each_body_has_its_own_saturated_colour():
    q = torch.stack([torch.linspace(-3, 3, 6), torch.zeros(6)], dim=-1)
    world = RgbWorld()
    column, row = world.camera.to_pixel(q).round().long().unbind(-1)
    seen = world(q)[:, row, column].T
    torch.testing.assert_close(seen, torch.tensor(PALETTE), atol=0.05, rtol=0)
    assert len(set(PALETTE)) == len(PALETTE)


def test_more_bodies_than_colours_are_refused():
    with pytest.raises(ValueError, match="7 bodies but a palette of 6"):
        RgbWorld(SMALL)(torch.zeros(7, 2))


@pytest.mark.parametrize("name", WORLDS)
def test_worlds_compile_into_one_graph(name, monkeypatch):
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)  # its checks do not compile
    world = world_of(name, SMALL)
    q = torch.tensor([[0.1, 0.2], [-0.3, 0.4]])
    compiled = torch.compile(world.__call__, backend="eager", fullgraph=True)
    torch.testing.assert_close(compiled(q), world(q), rtol=1e-6, atol=1e-6)


# centroid


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_centroid_is_exact_to_a_thousandth_of_a_pixel(dtype):
    camera = Camera(4.0, 48, 64)
    generator = torch.Generator().manual_seed(0)
    inside = torch.tensor([4.0, 3.0]) - 3.7 * 0.25
    q = (2 * torch.rand(300, 3, 2, generator=generator) - 1).to(dtype) * inside.to(dtype)
    found, mass = centroids(ChannelWorld(camera)(q), camera)
    error = (camera.to_pixel(found) - camera.to_pixel(q)).norm(dim=-1)
    assert float(error.max()) < 1e-3
    torch.testing.assert_close(
        mass, torch.full_like(mass, 2 * math.pi * 0.25**2), rtol=1e-3, atol=0
    )


def test_centroid_of_a_stored_frame():
    q = 2 * torch.rand(200, 3, 2, generator=torch.Generator().manual_seed(0)) - 1
    frames = (ChannelWorld()(q) * 255).round() / 255
    error = (centroids(frames, Camera())[0] - q).norm(dim=-1) / 0.125
    assert float(error.square().mean().sqrt()) < 5e-3


def test_black_channels_have_no_mass_and_a_finite_gradient():
    frames = torch.zeros(2, 5, 7, requires_grad=True)
    position, mass = centroids(frames, SMALL)
    (position.sum() + mass.sum()).backward()
    assert position.abs().sum() == 0
    assert mass.abs().sum() == 0
    assert torch.isfinite(frames.grad).all()


def test_centroid_gradient():
    frames = torch.rand(2, 5, 7, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert gradcheck(lambda x: centroids(x, SMALL), (frames.requires_grad_(),))


def test_frames_of_another_size_are_refused():
    with pytest.raises(ValueError, match=r"frames of \(7, 5\) pixels"):
        centroids(torch.zeros(1, 7, 5), SMALL)


# supersampling


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_supersampling_nears_the_mean_over_the_pixel(name, batch):
    q = 0.3 * torch.randn(*batch, 2, 2, dtype=torch.float64)
    world = world_of(name, Camera(1.5, 6, 8))
    fine = supersampled(world, 16)(q)
    assert fine.shape == world(q).shape
    errors = [float((supersampled(world, f)(q) - fine).abs().mean()) for f in (1, 2, 4)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_supersampling_less_than_once_is_refused():
    with pytest.raises(ValueError, match="factor must be at least 1, got 0"):
        supersampled(ChannelWorld(SMALL), 0)
