"""Splats of Triton's kernels, run by its interpreter, equal the plain ones."""

import subprocess
import sys

import pytest
import torch

import renderers.reused as reused
from loops import has_triton
from renderers import Camera, disks, gaussians
from tests.shared.kernels import interpreted

CAMERAS = {
    "one block, not full": Camera(half_extent=2.0, height=9, width=13),
    "2 x 2 blocks, the last ones not full": Camera(half_extent=2.0, height=21, width=300),
    "blocks below each other": Camera(half_extent=2.0, height=600, width=5),
    "a pixel": Camera(half_extent=2.0, height=1, width=1),
}
DRAW = {
    "gaussians": lambda q, camera, out=None: gaussians(q, camera, 0.4, out),
    "disks": lambda q, camera, out=None: disks(q, camera, 0.7, 0.1, out),
}
# In the frame, at its border, out of it, and where the offset in units of the edge is infinite.
PLACES = [[[0.3, -0.2], [-1.1, 0.15], [1.9, 0.1]], [[-0.1, 1.9], [2.3, -2.4], [1e3, -1.5e38]]]


def compare(name: str, camera: Camera, dtype: torch.dtype) -> None:
    """Pictures and slopes, within a few roundings of their largest terms."""
    q = torch.tensor(PLACES, dtype=dtype, requires_grad=True)
    plain = DRAW[name](q, camera)
    drawn = DRAW[name](q, camera, torch.full_like(plain, torch.nan))
    size = 32 * torch.finfo(dtype).eps
    torch.testing.assert_close(drawn, plain, rtol=size, atol=size)
    # Every pixel weighs differently, also from those in its row and column.
    upstream = torch.rand(plain.shape, dtype=dtype, generator=torch.Generator().manual_seed(0))
    found, twin = (torch.autograd.grad(x, q, upstream)[0] for x in (drawn, plain))
    torch.testing.assert_close(found, twin, rtol=size, atol=size * float(twin.abs().max()))


def compare_all() -> None:
    """With the kernels' loops in place of those for the CPU."""
    from renderers import compiled_cuda

    reused._loops = lambda images: compiled_cuda
    for dtype in (torch.float32, torch.float64):
        for name in DRAW:
            cameras = list(CAMERAS.values())
            for camera in cameras if dtype == torch.float32 else cameras[1:2]:
                compare(name, camera, dtype)
            empty = torch.zeros(0, 3, 2, dtype=dtype, requires_grad=True)
            none = DRAW[name](empty, camera, empty.new_empty(0, 3, camera.height, camera.width))
            assert torch.autograd.grad(none.sum(), empty)[0].shape == empty.shape
    camera, places = Camera(2.0, 9, 13), [[0.0, 0.0], [torch.nan, 0.0], [0.0, -torch.inf]]
    for edge in (None, 2.0):
        light = torch.zeros(3, 9, 13)
        compiled_cuda.draw(torch.tensor(places), camera, 2.0, edge, 9.0, light)
        assert light[0].isfinite().all() and light[1:].isnan().all()


@pytest.mark.skipif(not has_triton(), reason="triton is not installed")
def test_the_kernels_in_their_interpreter_draw_the_plain_pictures():
    interpreted("from tests.renderers import test_compiled_cuda as t; t.compare_all()")


def test_importing_renderers_imports_no_compiler():
    code = "import sys, renderers\nassert not {'numba', 'triton'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_torchs_operations_draw_where_no_loops_are_compiled():
    assert reused._loops(torch.empty(1, 2, 2, dtype=torch.float16)) is None
    assert reused._loops(torch.empty(1, 2, 2, device="meta")) is None
