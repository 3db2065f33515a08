"""Splats drawn into given memory equal the plain ones, values and gradients."""

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import renderers.reused as reused
from loops import has_numba
from renderers import Camera, disks, gaussians

FIXTURE = HealthCheck.function_scoped_fixture
CAMERA = Camera(half_extent=2.0, height=9, width=13)
DRAW = {
    "gaussians": lambda q, out=None: gaussians(q, CAMERA, 0.4, out),
    "disks": lambda q, out=None: disks(q, CAMERA, 0.7, 0.1, out),
}
coordinate = st.floats(-4.0, 4.0, allow_nan=False, width=32)
bodies = st.lists(st.tuples(coordinate, coordinate), min_size=1, max_size=5)


def memory(q: torch.Tensor) -> torch.Tensor:
    return torch.full((*q.shape[:-1], CAMERA.height, CAMERA.width), torch.nan, dtype=q.dtype)


def slopes(images: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    weights = torch.linspace(-1, 2, images.numel(), dtype=q.dtype).reshape(images.shape)
    return torch.autograd.grad((weights * images).sum(), q)[0]


@pytest.fixture(params=["loops", "torch"])
def way(request, monkeypatch):
    """Compiled loops over the images, and torch's operations where there are none."""
    if request.param == "torch":
        monkeypatch.setattr(reused, "has_numba", lambda: False)
    elif not has_numba():
        pytest.skip("needs numba")


@pytest.mark.parametrize("name", DRAW)
@settings(max_examples=25, deadline=None, suppress_health_check=[FIXTURE])
@given(places=bodies)
def test_given_memory_has_the_same_pictures_and_gradients(name, way, places):
    draw = DRAW[name]
    q = torch.tensor(places, dtype=torch.float64, requires_grad=True)
    plain, drawn = draw(q), draw(q, memory(q))
    torch.testing.assert_close(drawn, plain, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(slopes(drawn, q), slopes(plain, q), rtol=1e-10, atol=1e-12)


@pytest.fixture
def large_on_two_threads(monkeypatch):
    """Small images go the way of large ones: past the caches, and shared."""
    compiled = pytest.importorskip("renderers.compiled")
    monkeypatch.setattr(compiled, "CACHED", 0)
    monkeypatch.setattr(compiled, "FEWEST", 1)
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", DRAW)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("skip", [0, 1])
def test_large_images_are_the_plain_ones(name, dtype, skip, large_on_two_threads):
    """Blocks of rows go over the images' borders; ``skip`` numbers off a cache line, none can."""
    rng = torch.Generator().manual_seed(0)
    q = torch.randn(2, 3, 2, 2, generator=rng, dtype=dtype, requires_grad=True)
    whole = memory(q)
    numbers = torch.full((skip + whole.numel() + 1,), torch.nan, dtype=dtype)
    drawn = DRAW[name](q, numbers[skip:-1].view(whole.shape))
    plain = DRAW[name](q)
    torch.testing.assert_close(drawn, plain)
    torch.testing.assert_close(slopes(drawn, q), slopes(plain, q), rtol=1e-4, atol=1e-4)
    assert numbers[:skip].isnan().all()
    assert numbers[-1].isnan()


@pytest.mark.parametrize("name", DRAW)
def test_a_gradient_that_lies_across_is_read_as_it_is(name, way):
    q = torch.tensor([[0.3, -0.2], [1.0, 0.5]], dtype=torch.float64, requires_grad=True)
    upstream = torch.arange(2.0 * 13 * 9, dtype=torch.float64).view(2, 13, 9).mT
    found, plain = (
        torch.autograd.grad(x, q, upstream) for x in (DRAW[name](q, memory(q)), DRAW[name](q))
    )
    torch.testing.assert_close(found, plain)


@pytest.mark.parametrize("name", DRAW)
def test_no_frames_are_drawn_as_none(name, way):
    q = torch.zeros(0, 3, 2, requires_grad=True)
    drawn = DRAW[name](q, memory(q))
    assert drawn.shape == (0, 3, CAMERA.height, CAMERA.width)
    assert torch.autograd.grad(drawn.sum(), q)[0].shape == q.shape


@pytest.mark.parametrize("name", DRAW)
def test_what_is_drawn_lies_in_the_given_memory(name):
    q = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    out = memory(q)
    drawn = DRAW[name](q, out)
    assert drawn.data_ptr() == out.data_ptr()
    assert not out.requires_grad


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("far", [3.0, 50.0, -1e4, 1e18])
@pytest.mark.parametrize("softness", [0.3, 0.05, 0.009])
def test_disks_far_away_and_sharp_are_finite(dtype, far, softness, way):
    q = torch.tensor([[far, 0.1], [0.1, far], [far, -far]], dtype=dtype, requires_grad=True)
    drawn = disks(q, CAMERA, 0.7, softness, memory(q))
    torch.testing.assert_close(drawn, disks(q, CAMERA, 0.7, softness), rtol=1e-4, atol=1e-6)
    found, plain = slopes(drawn, q), slopes(disks(q, CAMERA, 0.7, softness), q)
    torch.testing.assert_close(found, plain, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("far", [5.0, 1e3, 1e18, 1e38])
def test_gaussians_far_away_have_neither_light_nor_gradient(far, way):
    q = torch.tensor([[far, 0.1], [0.1, -far]], requires_grad=True)
    drawn = gaussians(q, CAMERA, 0.4, memory(q))
    torch.testing.assert_close(drawn, gaussians(q, CAMERA, 0.4), rtol=1e-4, atol=1e-12)
    assert slopes(drawn, q).abs().max() < 1e-3


@pytest.mark.parametrize("followed", [True, False])
def test_a_gradient_through_a_picture_that_was_drawn_over_is_refused(followed, way):
    q = torch.zeros(1, 2, dtype=torch.float64, requires_grad=True)
    out = memory(q)
    first = disks(q, CAMERA, 0.7, 0.1, out)
    again = disks(q + 1 if followed else q.detach() + 1, CAMERA, 0.7, 0.1, out)
    assert again.requires_grad == followed
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        first.sum().backward()


def test_memory_that_does_not_fit_is_refused():
    q = torch.zeros(2, 2)
    with pytest.raises(ValueError, match=r"it must be \(2, 9, 13\)"):
        gaussians(q, CAMERA, 0.4, torch.empty(2, 9, 12))
    with pytest.raises(ValueError, match="of torch.float32"):
        disks(q, CAMERA, 0.4, 0.1, torch.empty(2, 9, 13, dtype=torch.float64))
    with pytest.raises(ValueError, match="contiguous"):
        gaussians(q, CAMERA, 0.4, torch.empty(2, 13, 9).mT)


def test_an_edge_too_sharp_for_its_factors_is_refused():
    with pytest.raises(ValueError, match=r"too sharp .*at least 0.00875"):
        disks(torch.zeros(1, 2), CAMERA, 0.7, 0.001, torch.empty(1, 9, 13))
