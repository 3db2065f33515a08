"""Splats in one pass over the images each way on CUDA, by Triton.

A program has a block of one picture, whose profiles it computes in registers: what goes through
memory is the pictures alone, once. Slopes are summed within a block by the kernel and over the
blocks by torch, always in one order, so that they come out the same in every run. The kernels run
in Triton's interpreter too, on the CPU, which is how they are tested.
"""

# Triton gives its own types to what a kernel is handed, and reads its annotations itself.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import Any, no_type_check

import torch
import triton
import triton.language as tl
from torch import Tensor

from renderers.camera import Camera

BYTES = 2**14  # of a block: enough of them under way to keep the memory busy, all in registers
WIDEST = 256  # columns of a block


def draw(
    centres: Tensor, camera: Camera, scale: float, edge: float | None, far: float, out: Tensor
) -> None:
    """Pictures of bodies, into ``out``; see :func:`renderers.compiled.draw`."""
    grid, sides = _blocks(camera, out)
    with torch.cuda.device_of(out):
        _draw[(len(centres) * grid,)](
            out, centres.contiguous(), *_numbers(camera, scale, edge, far), **sides
        )


def slopes(
    centres: Tensor,
    camera: Camera,
    scale: float,
    edge: float | None,
    far: float,
    drawn: Tensor | None,
    upstream: Tensor,
) -> Tensor:
    """Gradient with respect to the centres ``(n, 2)``; see :func:`renderers.compiled.slopes`."""
    grid, sides = _blocks(camera, upstream)
    parts = upstream.new_empty(len(centres), grid, 2)
    light = upstream if drawn is None else drawn.detach()
    with torch.cuda.device_of(upstream):
        _slopes[(len(centres) * grid,)](
            upstream, light, parts, centres.contiguous(), *_numbers(camera, scale, edge, far),
            **sides,
        )  # fmt: skip
    return parts.sum(1)


def _blocks(camera: Camera, images: Tensor) -> tuple[int, dict[str, int]]:
    """How many blocks a picture has, and their sides, powers of 2."""
    columns = min(WIDEST, triton.next_power_of_2(camera.width))
    rows = min(BYTES // images.itemsize // columns, triton.next_power_of_2(camera.height))
    grid = triton.cdiv(camera.height, rows) * triton.cdiv(camera.width, columns)
    return grid, {"R": rows, "C": columns}


def _numbers(camera: Camera, scale: float, edge: float | None, far: float) -> tuple[Any, ...]:
    """What both kernels are told: the picture's sides, half a pixel, lengths, and the edge."""
    sides = camera.height, camera.width
    return *sides, camera.units_per_pixel / 2, scale, far, edge or 0.0, edge is not None


@triton.jit
@no_type_check
def _offset(halves, centre, half, scale, far):  # noqa: ANN001, ANN202
    """Offsets of pixels that lie so many ``half`` pixels off the picture's middle."""
    # A number comes in double precision, and would take the pixels along to it.
    real: tl.constexpr = centre.dtype
    most = tl.full([], far, real)
    offset = (halves.to(real) * tl.full([], half, real) - centre) * tl.full([], scale, real)
    offset = tl.maximum(offset, -most, propagate_nan=tl.PropagateNan.ALL)
    return tl.minimum(offset, most, propagate_nan=tl.PropagateNan.ALL)


@triton.jit
@no_type_check
def _block(centres, height, width, half, scale, far, R: tl.constexpr, C: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """A program's block: where its pixels lie, which of them there are, and their dx and dy."""
    across, down = tl.cdiv(width, C), tl.cdiv(height, R)
    place = tl.program_id(0) // across
    picture = (place // down).to(tl.int64)
    top, left = place % down * R, tl.program_id(0) % across * C
    r, c = tl.arange(0, R), tl.arange(0, C)
    row, column = top + r, left + c
    # All pictures may have more pixels than 32 bits can count, a block has not.
    first = (picture * height + top) * width + left
    at = first + (r[:, None] * width + c[None, :])
    inside = (row < height)[:, None] & (column < width)[None, :]
    x, y = tl.load(centres + 2 * picture), tl.load(centres + 2 * picture + 1)
    x, y = x + (x - x), y + (y - y)  # infinitely far away there is no light, which would be silent
    dx = _offset(2 * column - (width - 1), x, half, scale, far)
    dy = _offset((height - 1) - 2 * row, y, half, scale, far)
    return at, inside, dx[None, :], dy[:, None]


@triton.jit
@no_type_check
def _draw(  # noqa: ANN202
    out, centres, height, width,  # noqa: ANN001
    half: tl.float64, scale: tl.float64, far: tl.float64, edge: tl.float64,
    EDGED: tl.constexpr, R: tl.constexpr, C: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """A block of ``R`` rows and ``C`` columns; see :func:`renderers.compiled.draw`."""
    at, inside, dx, dy = _block(centres, height, width, half, scale, far, R, C)
    if EDGED:
        light = 1 / (1 + tl.exp(dy * dy - tl.full([], edge, dy.dtype)) * tl.exp(dx * dx))
    else:
        light = tl.exp(-dy * dy) * tl.exp(-dx * dx)
    tl.store(out + at, light, inside)


@triton.jit
@no_type_check
def _slopes(  # noqa: ANN202
    upstream, drawn, parts, centres, height, width,  # noqa: ANN001
    half: tl.float64, scale: tl.float64, far: tl.float64, edge: tl.float64,
    EDGED: tl.constexpr, R: tl.constexpr, C: tl.constexpr,  # noqa: N803
):  # fmt: skip
    """What a block adds to the two slopes of its body, into ``parts``."""
    at, inside, dx, dy = _block(centres, height, width, half, scale, far, R, C)
    slope = tl.load(upstream + at, inside, 0.0)
    if EDGED:
        light = tl.load(drawn + at, inside, 0.0)
        slope = slope * light * (1 - light)
    else:
        slope = slope * tl.exp(-dy * dy) * tl.exp(-dx * dx)
    twice = 2 * tl.full([], scale, dx.dtype)
    to = parts + 2 * tl.program_id(0).to(tl.int64)
    tl.store(to, twice * tl.sum(slope * dx))
    tl.store(to + 1, twice * tl.sum(slope * dy))
