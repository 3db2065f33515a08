"""Splats drawn into memory that is there already, with their gradients written out.

A fresh tensor of many frames costs more in page faults than the drawing itself. Here the caller
brings the memory, one pass writes it, and the gradient reads it once: nothing else of the images'
size is made. The plain formulas of :mod:`renderers.splats` are the twins that these are tested
against; unlike them, these have first derivatives only and no forward mode.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.function import once_differentiable

from renderers.camera import Camera

PIECE = 2**20  # numbers at once on a CPU: what several passes go over stays in its cache
SHARPEST = 40.0  # R / 2s: a sharper disk's factors leave the range of single precision
FARTHEST = 80.0  # exponent of a factor; e^-(80 - 40) is no light in either precision


def draw_gaussians(centres: Tensor, camera: Camera, sigma: float, out: Tensor) -> Tensor:
    """:func:`renderers.gaussians` into ``out``."""
    _check("gaussians", centres, camera, out)
    return _Gaussians.apply(centres, camera, sigma, out.detach())


def draw_disks(
    centres: Tensor, camera: Camera, radius: float, softness: float, out: Tensor
) -> Tensor:
    """:func:`renderers.disks` into ``out``.

    The edge's sigmoid of (R^2 - dx^2 - dy^2) / 2Rs is 1 / (1 + e^(dx^2 / 2Rs) e^((dy^2 - R^2) /
    2Rs)): one exponential a row and a column, and a reciprocal a pixel.

    Raises:
        ValueError: the memory does not fit, or the edge is too sharp for its factors.
    """
    _check("disks", centres, camera, out)
    if radius > 2 * softness * SHARPEST:
        raise ValueError(
            f"disks: an edge of {softness:g} is too sharp for a radius of {radius:g} to be drawn "
            f"into out (at least {radius / (2 * SHARPEST):g}); leave out away"
        )
    return _Disks.apply(centres, camera, radius, softness, out.detach())


class _Gaussians(Function):
    @staticmethod
    def forward(ctx: Any, centres: Tensor, camera: Camera, sigma: float, out: Tensor) -> Tensor:
        dx, dy = _offsets(centres.detach(), camera)
        across, down = ((d.square() * (-0.5 / sigma**2)).exp() for d in (dx, dy))
        torch.mul(down.unsqueeze(-1), across.unsqueeze(-2), out=out)
        ctx.mark_dirty(out)
        ctx.save_for_backward(dx, dy, across, down)
        ctx.sigma = sigma
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None]:
        dx, dy, across, down = ctx.saved_tensors
        plain, turned = _columns(torch.stack([down, down * dy], -2), gradient)
        x, y = (across * dx * plain).sum(-1), (across * turned).sum(-1)
        return torch.stack([x, y], -1) / ctx.sigma**2, None, None, None


class _Disks(Function):
    @staticmethod
    def forward(
        ctx: Any, centres: Tensor, camera: Camera, radius: float, softness: float, out: Tensor
    ) -> Tensor:
        scale = (2 * radius * softness) ** -0.5  # lengths in it are pure numbers of moderate size
        dx, dy = (d * scale for d in _offsets(centres.detach(), camera))
        across, dx = _grown(dx, 0.0)
        down, dy = _grown(dy, (radius * scale) ** 2)
        pieces = (x.flatten(0, -2).split(_rows(out)) for x in (across, down))
        for drawn, a, b in zip(_pieces(out), *pieces, strict=True):
            torch.mul(b.unsqueeze(-1), a.unsqueeze(-2), out=drawn)
            drawn.add_(1).reciprocal_()
        ctx.mark_dirty(out)
        ctx.save_for_backward(dx, dy, across, down, out)
        ctx.scale = scale
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None, None, None]:
        dx, dy, across, down, out = ctx.saved_tensors
        weights = torch.stack([down, down * dy], -2).flatten(0, -3).split(_rows(out))
        gradient = gradient.contiguous()
        scratch = torch.empty_like(_pieces(out)[0])
        found = []
        for drawn, g, w in zip(_pieces(out), _pieces(gradient), weights, strict=True):
            inner = torch.mul(drawn, drawn, out=scratch[: len(drawn)]).mul_(g)
            found.append(_columns(w, inner))
        plain, turned = (torch.cat(x).reshape(across.shape) for x in zip(*found, strict=True))
        x, y = (across * dx * plain).sum(-1), (across * turned).sum(-1)
        return 2 * ctx.scale * torch.stack([x, y], -1), None, None, None, None


def _offsets(centres: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """From each body's centre to the columns ``(..., n, W)`` and to the rows ``(..., n, H)``."""
    xs, ys = (f(centres.dtype, centres.device) for f in (camera.xs, camera.ys))
    return xs - centres[..., 0:1], ys - centres[..., 1:2]


def _grown(distance: Tensor, less: float) -> tuple[Tensor, Tensor]:
    """exp(d^2 - less) within the range of numbers, and d where it is not cut off, else 0."""
    exponent = distance.square() - less
    inside = exponent < FARTHEST
    return exponent.clamp_max(FARTHEST).exp(), torch.where(inside, distance, 0)


def _columns(weights: Tensor, images: Tensor) -> tuple[Tensor, Tensor]:
    """Two weighted sums over the rows, ``(..., 2, H)`` and ``(..., H, W)``: two of ``(..., W)``."""
    plain, turned = (weights @ images).unbind(-2)
    return plain, turned


def _rows(images: Tensor) -> int:
    """Images a piece."""
    size = images.shape[-2] * images.shape[-1]
    return max(1, PIECE // size) if images.device.type == "cpu" else images.numel() // size


def _pieces(images: Tensor) -> tuple[Tensor, ...]:
    return images.view(-1, *images.shape[-2:]).split(_rows(images))


def _check(who: str, centres: Tensor, camera: Camera, out: Tensor) -> None:
    shape = (*centres.shape[:-1], camera.height, camera.width)
    if out.shape != shape or out.dtype != centres.dtype or out.device != centres.device:
        raise ValueError(
            f"{who}: out is {tuple(out.shape)} of {out.dtype} on {out.device}; it must be {shape} "
            f"of {centres.dtype} on {centres.device}"
        )
    if not out.is_contiguous() or out.requires_grad:
        raise ValueError(f"{who}: out must be contiguous and have no gradient of its own")
