"""Splats drawn into given memory equal the plain ones, values and gradients."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import renderers.reused as reused
from renderers import Camera, disks, gaussians

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


@pytest.mark.parametrize("name", DRAW)
@settings(max_examples=25, deadline=None)
@given(places=bodies)
def test_given_memory_has_the_same_pictures_and_gradients(name, places):
    draw = DRAW[name]
    q = torch.tensor(places, dtype=torch.float64, requires_grad=True)
    plain, drawn = draw(q), draw(q, memory(q))
    torch.testing.assert_close(drawn, plain, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(slopes(drawn, q), slopes(plain, q), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", DRAW)
def test_pieces_are_the_whole(name, monkeypatch):
    draw = DRAW[name]
    rng = torch.Generator().manual_seed(0)
    q = torch.randn(2, 3, 2, 2, generator=rng, dtype=torch.float64, requires_grad=True)
    monkeypatch.setattr(reused, "PIECE", 2 * CAMERA.height * CAMERA.width)
    drawn = draw(q, memory(q))
    torch.testing.assert_close(drawn, draw(q))
    torch.testing.assert_close(slopes(drawn, q), slopes(draw(q), q))


@pytest.mark.parametrize("name", DRAW)
def test_what_is_drawn_lies_in_the_given_memory(name):
    q = torch.zeros(2, 2, dtype=torch.float64, requires_grad=True)
    out = memory(q)
    drawn = DRAW[name](q, out)
    assert drawn.data_ptr() == out.data_ptr()
    assert not out.requires_grad


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("far", [3.0, 50.0, -1e4, 1e18])
@pytest.mark.parametrize("softness", [0.3, 0.05, 0.009])
def test_disks_far_away_and_sharp_are_finite(dtype, far, softness):
    q = torch.tensor([[far, 0.1], [0.1, far], [far, -far]], dtype=dtype, requires_grad=True)
    drawn = disks(q, CAMERA, 0.7, softness, memory(q))
    torch.testing.assert_close(drawn, disks(q, CAMERA, 0.7, softness), rtol=1e-4, atol=1e-6)
    found, plain = slopes(drawn, q), slopes(disks(q, CAMERA, 0.7, softness), q)
    torch.testing.assert_close(found, plain, rtol=1e-3, atol=1e-4)


def test_a_gradient_through_a_picture_that_was_drawn_over_is_refused():
    q = torch.zeros(1, 2, dtype=torch.float64, requires_grad=True)
    out = memory(q)
    first = disks(q, CAMERA, 0.7, 0.1, out)
    disks(q + 1, CAMERA, 0.7, 0.1, out)
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
