"""Bodies as splats: Gaussians and soft-edged disks, twice differentiable in their centres."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

from renderers.camera import Camera
from renderers.memory import check_fits
from renderers.reused import draw_disks, draw_gaussians


def gaussians(
    centres: Float[Tensor, "*b n 2"],
    camera: Camera,
    sigma: float,
    out: Float[Tensor, "*b n H W"] | None = None,
) -> Float[Tensor, "*b n H W"]:
    """One isotropic Gaussian of peak 1 per body.

    It is separable, so each image is the outer product of two profiles: H + W exponentials
    instead of H * W.

    Args:
        centres: (x, y) in world units. A body out of the frame leaves its tail, or nothing.
        camera: the pixel grid.
        sigma: standard deviation, world units.
        out: memory to draw into, which several times speeds up what is larger than a cache; then
            there are first derivatives only, and no backward pass once it is drawn over.

    Raises:
        ValueError: a centre is not finite (on a card, which would have to be waited for, its
            picture is NaN instead), ``sigma`` is not positive, or ``out`` does not fit.

    Example:
        >>> frames = gaussians(torch.zeros(1, 2), Camera(height=33, width=33), sigma=0.5)
        >>> tuple(frames.shape), float(frames[0, 16, 16])
        ((1, 33, 33), 1.0)
    """
    if out is not None:
        _check_positive("gaussians", "sigma", sigma)
        _check_finite("gaussians", centres)
        return draw_gaussians(centres, camera, sigma, out)
    across, down = _profiles(centres, camera, sigma)
    _check_fits("gaussians", centres, camera)
    # as a matrix product: its backward makes no image-sized temporaries, a broadcast one's does
    return down.unsqueeze(-1) @ across.unsqueeze(-2)


def gaussian_sum(
    centres: Float[Tensor, "*b n 2"], weights: Float[Tensor, "*b n"], camera: Camera, sigma: float
) -> Float[Tensor, "*b H W"]:
    """The weighted sum over bodies of :func:`gaussians`, without an image per body.

    Args:
        centres: (x, y) in world units.
        weights: peak of each body.
        camera: the pixel grid.
        sigma: standard deviation, world units.

    Raises:
        ValueError: a centre is not finite, see :func:`gaussians`, or ``sigma`` is not positive.
    """
    across, down = _profiles(centres, camera, sigma)
    return (down * weights.unsqueeze(-1)).transpose(-1, -2) @ across


def disks(
    centres: Float[Tensor, "*b n 2"],
    camera: Camera,
    radius: float,
    softness: float,
    out: Float[Tensor, "*b n H W"] | None = None,
) -> Float[Tensor, "*b n H W"]:
    """Coverage in (0, 1) of one soft-edged disk per body; see :func:`disk_coverage`.

    Args:
        centres: (x, y) in world units.
        camera: the pixel grid.
        radius, softness: world units.
        out: memory to draw into; see :func:`gaussians`.

    Raises:
        ValueError: a centre is not finite, see :func:`gaussians`, ``radius`` or ``softness`` is
            not positive, or ``out`` does not fit.

    Example:
        >>> camera = Camera()
        >>> light = disks(torch.zeros(1, 2), camera, radius=1.0, softness=0.05)
        >>> round(float(light.sum()) * camera.units_per_pixel**2, 2)  # world units squared, near pi
        3.14
    """
    _check_finite("disks", centres)
    if out is not None:
        _check_positive("disks", "radius", radius)
        _check_positive("disks", "softness", softness)
        return draw_disks(centres, camera, radius, softness, out)
    _check_fits("disks", centres, camera)
    dx, dy = camera.offsets(centres)
    squared = dy.square().unsqueeze(-1) + dx.square().unsqueeze(-2)
    return disk_coverage(squared, radius, softness)


def disk_coverage(
    squared: Float[Tensor, "*shape"], radius: float, softness: float
) -> Float[Tensor, "*shape"]:
    """Coverage of a disk at a squared distance from its centre: a sigmoid edge, 1/2 at the radius.

    The sigmoid's argument is (R^2 - r^2) / (2 R s), which has the slope of (R - r) / s at the
    edge and, unlike it, a finite gradient at the exact centre.

    Args:
        squared: squared distance, world units squared.
        radius: R, world units.
        softness: s, world units; the edge rises from 10 % to 90 % over about 4.4 s.

    Raises:
        ValueError: ``radius`` or ``softness`` is not positive.

    Example:
        >>> squared = torch.tensor([0.0, 1.0, 4.0])
        >>> [round(x, 3) for x in disk_coverage(squared, radius=1.0, softness=0.1).tolist()]
        [0.993, 0.5, 0.0]
    """
    _check_positive("disks", "radius", radius)
    _check_positive("disks", "softness", softness)
    return torch.sigmoid((radius**2 - squared) / (2 * radius * softness))


def _profiles(centres: Tensor, camera: Camera, sigma: float) -> tuple[Tensor, Tensor]:
    """The Gaussians along x, ``(..., n, W)``, and along y, ``(..., n, H)``."""
    _check_positive("gaussians", "sigma", sigma)
    _check_finite("gaussians", centres)
    dx, dy = camera.offsets(centres)
    scale = -0.5 / sigma**2
    return (dx.square() * scale).exp(), (dy.square() * scale).exp()


def _check_positive(who: str, name: str, length: float) -> None:
    if not (math.isfinite(length) and length > 0):
        raise ValueError(f"{who}: {name} must be a positive length in world units, got {length}")


def _check_fits(who: str, centres: Tensor, camera: Camera) -> None:
    shape = (*centres.shape[:-1], camera.height, camera.width)
    check_fits(who, shape, centres.dtype, centres.device)


def _check_finite(who: str, centres: Tensor) -> None:
    """Name the first body whose centre is NaN or infinite; a card's numbers are not waited for."""
    if centres.device.type == "cuda" or torch.compiler.is_compiling():
        return
    if math.isfinite(float(centres.detach().sum())):
        return  # a sum that is finite has finite terms; others may sum up to an infinity
    if bool(torch.isfinite(centres).all()):
        return
    *batch, body, _ = torch.nonzero(~torch.isfinite(centres))[0].tolist()
    where = f" at batch index {tuple(batch)}" if batch else ""
    raise ValueError(
        f"{who}: the position of body {body}{where} is not finite; "
        "drop or repair it before rendering"
    )
