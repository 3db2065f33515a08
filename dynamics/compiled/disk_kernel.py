"""Kernels of the disk that a pair law's network sees, there and back; ``disk_cuda`` calls them.

The arithmetic of one displacement is that of the rollouts in ``cuda`` too.
"""

# Triton gives its own types to what a kernel is handed, and reads its annotations itself.
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from typing import no_type_check

import triton
import triton.language as tl

from dynamics.potentials import CORE, REACH, SPREAD

# They stand on the right of what they are applied to: Triton's interpreter knows them there alone.
CORE2, SHORT, WIDE = tl.constexpr(CORE**2), tl.constexpr(REACH), tl.constexpr(SPREAD)


@triton.jit
@no_type_check
def squashed(x, y):  # noqa: ANN001, ANN201
    """Displacements in the disk, where they are at most 1 long."""
    shrink = 1 / (tl.sqrt(x * x + y * y + CORE2) + SHORT)
    return x * shrink, y * shrink


@triton.jit
@no_type_check
def _placed(x, y):  # noqa: ANN001, ANN202
    """The direction d / r of a displacement, how it is squashed, and how deep in the core it is."""
    r = tl.sqrt(x * x + y * y + CORE2)
    over = 1 / r
    return x * over, y * over, 1 / (r + SHORT), over * over * CORE2


@triton.jit
@no_type_check
def turned(x, y, to_u, to_v):  # noqa: ANN001, ANN201
    """See :func:`dynamics.potentials.unsquashed`: M (to_u, to_v), of displacements (x, y).

    In parts along the direction and across it: of what goes along, little is left far out, which
    so is no difference of large numbers.
    """
    n, m, shrink, core = _placed(x, y)
    inward = shrink * SHORT * (n * to_u + m * to_v)
    across = n * to_v - m * to_u
    at_u = shrink * (core * to_u + n * inward - m * across)
    return at_u, shrink * (core * to_v + m * inward + n * across)


@triton.jit
@no_type_check
def _turned_back(x, y, s, t, w, z):  # noqa: ANN001, ANN202
    """The gradient of (w, z) M (s, t) with respect to the displacement (x, y), in such parts."""
    n, m, shrink, core = _placed(x, y)
    along, across = n * s + m * t, n * t - m * s
    ahead, aside = n * w + m * z, n * z - m * w
    inward = shrink * SHORT * 2 * along * ahead + across * aside + core * (s * w + t * z)
    sideways = along * aside + across * ahead
    on_x = m * sideways - n * inward - core * (ahead * s + along * w)
    on_y = -n * sideways - m * inward - core * (ahead * t + along * z)
    return shrink * shrink * on_x, shrink * shrink * on_y


@triton.jit
@no_type_check
def _rows(rows, R: tl.constexpr):  # noqa: ANN001, ANN202, N803
    """Where a program's displacements lie, where both their inputs do, and which there are."""
    model = tl.program_id(1).to(tl.int64)
    row = tl.program_id(0) * R + tl.arange(0, R)
    one = 2 * (2 * model * rows + row)
    return 2 * (model * rows + row), one, one + 2 * rows, row < rows


@triton.jit
@no_type_check
def _loaded(x, at, there):  # noqa: ANN001, ANN202
    return tl.load(x + at, there, 0.0), tl.load(x + at + 1, there, 0.0)


@triton.jit
@no_type_check
def _stored(x, at, there, u, v):  # noqa: ANN001, ANN202
    tl.store(x + at, u, there)
    tl.store(x + at + 1, v, there)


@triton.jit
@no_type_check
def squash(d, out, rows, R: tl.constexpr):  # noqa: ANN001, ANN201, N803
    """The network's inputs of ``R`` displacements of a model: u in the disk, and -u, spread."""
    at, one, other, there = _rows(rows, R)
    x, y = _loaded(d, at, there)
    u, v = squashed(x, y)
    u, v = u * WIDE, v * WIDE
    _stored(out, one, there, u, v)
    _stored(out, other, there, -u, -v)


@triton.jit
@no_type_check
def _difference(slopes, one, other, there, scale):  # noqa: ANN001, ANN202
    """Slopes of the disk's energy, from those at both of the network's inputs."""
    u, v = _loaded(slopes, one, there)
    u_there, v_there = _loaded(slopes, other, there)
    return scale * (u - u_there), scale * (v - v_there)


@triton.jit
@no_type_check
def turn(d, slopes, out, scale, rows, R: tl.constexpr):  # noqa: ANN001, ANN201, N803
    """Slopes at both inputs, as one with respect to each displacement, times ``scale``."""
    at, one, other, there = _rows(rows, R)
    x, y = _loaded(d, at, there)
    s, t = _difference(slopes, one, other, there, scale)
    u, v = turned(x, y, s, t)
    _stored(out, at, there, u, v)


@triton.jit
@no_type_check
def turn_back(d, slopes, above, on_slopes, on_d, scale, rows, R: tl.constexpr):  # noqa: ANN001, ANN201, N803
    """The way back of :func:`turn`: the gradients of the slopes and of the displacements."""
    at, one, other, there = _rows(rows, R)
    x, y = _loaded(d, at, there)
    s, t = _difference(slopes, one, other, there, scale)
    w, z = _loaded(above, at, there)
    u, v = turned(x, y, w, z)
    u, v = u * scale, v * scale
    _stored(on_slopes, one, there, u, v)
    _stored(on_slopes, other, there, -u, -v)
    u, v = _turned_back(x, y, s, t, w, z)
    _stored(on_d, at, there, u, v)
