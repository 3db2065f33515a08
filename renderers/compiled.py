"""Splats in one pass over the images each way, for numba on the CPU.

Columns of a row lie innermost in every loop, so that the compiler turns it into vector
instructions. Images larger than the caches pass them by, a block of ``ROWS`` rows at a time: so
many rows of any width end where a cache line does. Profiles are numpy's: torch's threads would go
on spinning after they have shared even this little, where the loops want to run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from loops.kernels import kernel
from loops.streams import CACHED, LINE, streaming
from loops.threads import in_threads
from renderers.camera import Camera

ROWS = 16
FEWEST = 2**17  # numbers that are worth waking another thread for
Array = NDArray[Any]
stream = streaming(ROWS)


def draw(
    centres: Tensor, camera: Camera, scale: float, edge: float | None, far: float, out: Tensor
) -> None:
    """exp(-dx^2 - dy^2) of each body, or with an edge 1 / (1 + exp(dx^2 + dy^2 - edge)).

    Args:
        centres: ``(n, 2)``, world units.
        camera: the pixel grid.
        scale: dx and dy are in units of 1 / ``scale``.
        edge: see above; ``None`` for Gaussians.
        far: where dx and dy are cut off.
        out: ``(n, H, W)``, contiguous; is written.
    """
    (_, across), (_, down) = _profiles(centres, camera, scale, edge, far)
    flat, width, edged = out.view(-1).numpy(), out.shape[2], edge is not None
    large = out.nbytes > CACHED and out.data_ptr() % LINE == 0

    def part(which: tuple[int, int]) -> None:
        room = torch.empty(ROWS * width, dtype=out.dtype).numpy()  # torch's begin a cache line
        some = which[0] * ROWS, min(which[1] * ROWS, down.size)
        _draw(down.ravel(), across, edged, large, room, flat, *some)

    in_threads(part, -(-down.size // ROWS), _fewest(ROWS * width))


def slopes(
    centres: Tensor,
    camera: Camera,
    scale: float,
    edge: float | None,
    far: float,
    drawn: Tensor | None,
    upstream: Tensor,
) -> Tensor:
    """Gradient with respect to the centres of what :func:`draw` has drawn.

    Args:
        centres, camera, scale, edge, far: see there.
        drawn: the pictures; of Gaussians they are not asked for.
        upstream: ``(n, H, W)``, contiguous.

    Returns:
        ``(n, 2)``.
    """
    (dx, across), (dy, down) = _profiles(centres, camera, scale, edge, far)
    above, found = upstream.numpy(), np.empty_like(centres.numpy())
    below = None if drawn is None else drawn.detach().numpy()

    def part(which: tuple[int, int]) -> None:
        room = np.empty((2, dx.shape[1]), dx.dtype)
        if below is None:
            _slopes(dx, dy, across, down, above, room, found, *which)
        else:
            _edge_slopes(dx, dy, below, above, room, found, *which)

    in_threads(part, len(centres), _fewest(upstream.shape[1:].numel()))
    return 2 * scale * torch.from_numpy(found)


def _profiles(
    centres: Tensor, camera: Camera, scale: float, edge: float | None, far: float
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Offsets dx ``(n, W)`` and dy ``(n, H)``, each with its factor of the picture."""
    found, sides = [], (camera.xs(centres.dtype), camera.ys(centres.dtype))
    for i, side in enumerate(sides):
        d = side.numpy() - centres.numpy()[:, i, None]
        d *= scale
        np.clip(d, -far, far, out=d)
        factor = d * d
        factor *= -1 if edge is None else 1
        factor -= i * (edge or 0)
        found.append((d, np.exp(factor, out=factor)))
    return found[0], found[1]


def _fewest(numbers: int) -> int:
    """Blocks, of so many numbers each, that are worth waking another thread for."""
    return -(-FEWEST // max(1, numbers))


@kernel
def _draw(
    down: Array,
    across: Array,
    edged: bool,
    large: bool,
    room: Array,
    out: Array,
    begin: int,
    end: int,
) -> None:
    """Some rows of all images.

    Args:
        down: a factor of each row.
        across: ``(n, W)``.
        edged: whether there is an edge.
        large: whether to pass the caches by.
        room: scratch for a block of rows.
        out: flat.
        begin, end: the first row, a multiple of ``ROWS``, and the one after the last.
    """
    width, height, one = across.shape[1], len(down) // len(across), out.dtype.type(1)
    for first in range(begin, end, ROWS):
        size = (min(first + ROWS, end) - first) * width
        for at in range(0, size, width):
            row = first + at // width
            line, profile, factor = room[at : at + width], across[row // height], down[row]
            for x in range(width):
                line[x] = factor * profile[x]
        if edged:
            for i in range(size):
                room[i] = one / (one + room[i])
        block = out[first * width : first * width + size]
        if large and size == ROWS * width:
            for i in range(0, size, ROWS):
                stream(room, i, block, i)
        else:
            for i in range(size):
                block[i] = room[i]


@kernel
def _slopes(
    dx: Array,
    dy: Array,
    across: Array,
    down: Array,
    upstream: Array,
    room: Array,
    found: Array,
    begin: int,
    end: int,
) -> None:
    """Gaussians' halves of slopes in units of ``scale``, of some images.

    Sums over the rows come first: those over a row would be made one number after another.

    Args:
        dx, dy, across, down, upstream: see above.
        room: scratch for two rows.
        found: ``(n, 2)``; is written.
        begin, end: the first image, and the one after the last.
    """
    plain, turned = room[0], room[1]
    for image in range(begin, end):
        room[:] = 0
        for y in range(dy.shape[1]):
            row, weight = upstream[image, y], down[image, y]
            bent = weight * dy[image, y]
            for x in range(len(row)):
                plain[x] += weight * row[x]
                turned[x] += bent * row[x]
        for x in range(len(plain)):
            plain[x] *= across[image, x]
            turned[x] *= across[image, x]
        _along_and_upwards(dx[image], plain, turned, found[image])


@kernel
def _edge_slopes(
    dx: Array,
    dy: Array,
    drawn: Array,
    upstream: Array,
    room: Array,
    found: Array,
    begin: int,
    end: int,
) -> None:
    """The same of disks, through the sigmoid's slope ``drawn * (1 - drawn)``."""
    (plain, turned), one = (room[0], room[1]), drawn.dtype.type(1)
    for image in range(begin, end):
        room[:] = 0
        for y in range(dy.shape[1]):
            row, light, bent = upstream[image, y], drawn[image, y], dy[image, y]
            for x in range(len(row)):
                slope = row[x] * light[x] * (one - light[x])
                plain[x] += slope
                turned[x] += bent * slope
        _along_and_upwards(dx[image], plain, turned, found[image])


@kernel
def _along_and_upwards(dx: Array, plain: Array, turned: Array, found: Array) -> None:
    """What is left to sum, over the columns."""
    along, upwards = 0.0, 0.0
    for x in range(len(plain)):
        along += dx[x] * plain[x]
        upwards += turned[x]
    found[0], found[1] = along, upwards
