"""Splats drawn into memory that is there already, with their gradients written out.

A fresh tensor of many frames costs more in page faults than the drawing itself. Here the caller
brings the memory, one pass writes it, and the gradient reads it once: nothing else of the images'
size is made where there are compiled loops, numba's on a CPU and Triton's on a card. The plain
formulas of :mod:`renderers.splats` are the twins that these are tested against; unlike them, these
have first derivatives only and no forward mode.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd import Function
from torch.autograd.forward_ad import unpack_dual
from torch.autograd.function import once_differentiable
from torch.autograd.graph import increment_version

from loops import has_numba, has_triton
from renderers.camera import Camera

SHARPEST = 40.0  # R / 2s: a sharper disk's factors leave the range of single precision
FAR = 80.0**0.5  # e^(d^2) farther off leaves it too; e^-(80 - 40) is no light in either


def draw_gaussians(centres: Tensor, camera: Camera, sigma: float, out: Tensor) -> Tensor:
    """:func:`renderers.gaussians` into ``out``."""
    _check("gaussians", centres, camera, out)
    return _drawn(centres, camera, 0.5**0.5 / sigma, None, out.detach())


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
    scale = (2 * radius * softness) ** -0.5
    return _drawn(centres, camera, scale, (radius * scale) ** 2, out.detach())


def _drawn(
    centres: Tensor, camera: Camera, scale: float, edge: float | None, out: Tensor
) -> Tensor:
    """exp(-d^2) of the distance in units of 1 / ``scale``, or with an edge sigmoid(edge - d^2)."""
    derived = centres.requires_grad and torch.is_grad_enabled()
    if derived or unpack_dual(centres).tangent is not None:  # the latter is refused there
        return _Splats.apply(centres, camera, scale, edge, out)
    _draw(centres, camera, scale, edge, out)  # asking torch for a gradient costs as much again
    increment_version(out)
    return out


class _Splats(Function):
    """What :func:`_draw` draws, with its gradient."""

    @staticmethod
    def forward(
        ctx: Any, centres: Tensor, camera: Camera, scale: float, edge: float | None, out: Tensor
    ) -> Tensor:
        ctx.given = camera, scale, edge
        _draw(centres, camera, scale, edge, out)
        ctx.mark_dirty(out)
        ctx.save_for_backward(centres, None if edge is None else out)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None, None, None, None]:
        (centres, out), (camera, scale, edge) = ctx.saved_tensors, ctx.given
        if loops := _loops(upstream):
            flat, above = centres.detach().flatten(0, -2), upstream.contiguous().flatten(0, -3)
            drawn = None if out is None else out.flatten(0, -3)
            slopes = loops.slopes(flat, camera, scale, edge, FAR, drawn, above)
            return slopes.view(centres.shape), None, None, None, None
        (dx, across), (dy, down) = _profiles(centres, camera, scale, edge)
        if out is not None:
            upstream = torch.ops.aten.sigmoid_backward(upstream, out)
            across, down = torch.ones_like(dx), torch.ones_like(dy)
        plain, turned = (torch.stack([down, down * dy], -2) @ upstream).unbind(-2)
        x, y = (across * dx * plain).sum(-1), (across * turned).sum(-1)
        return 2 * scale * torch.stack([x, y], -1), None, None, None, None


def _draw(centres: Tensor, camera: Camera, scale: float, edge: float | None, out: Tensor) -> None:
    """Draw by compiled loops, or by torch's operations."""
    if loops := _loops(out):
        flat, images = centres.detach().flatten(0, -2), out.flatten(0, -3)
        loops.draw(flat, camera, scale, edge, FAR, images)
        return
    (_, across), (_, down) = _profiles(centres, camera, scale, edge)
    torch.mul(down.unsqueeze(-1), across.unsqueeze(-2), out=out)
    if edge is not None:
        out.add_(1).reciprocal_()


def _profiles(
    centres: Tensor, camera: Camera, scale: float, edge: float | None
) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Offsets dx ``(..., n, W)`` and dy ``(..., n, H)``, each with its factor of the picture."""
    dx, dy = ((offset * scale).clamp(-FAR, FAR) for offset in camera.offsets(centres))
    sign = -1 if edge is None else 1
    across, down = (sign * dx.square()).exp(), (sign * dy.square() - (edge or 0)).exp()
    return (dx, across), (dy, down)


def _loops(images: Tensor) -> Any:
    """Compiled loops over such images, where they lie; ``None`` for torch's operations."""
    if images.dtype not in (torch.float32, torch.float64) or torch.compiler.is_compiling():
        return None
    if images.device.type == "cpu" and has_numba():
        from renderers import compiled

        return compiled
    if images.device.type == "cuda" and has_triton():
        from renderers import compiled_cuda

        return compiled_cuda
    return None


def _check(who: str, centres: Tensor, camera: Camera, out: Tensor) -> None:
    shape = (*centres.shape[:-1], camera.height, camera.width)
    if out.shape != shape or out.dtype != centres.dtype or out.device != centres.device:
        raise ValueError(
            f"{who}: out is {tuple(out.shape)} of {out.dtype} on {out.device}; it must be {shape} "
            f"of {centres.dtype} on {centres.device}"
        )
    if not out.is_contiguous() or out.requires_grad:
        raise ValueError(f"{who}: out must be contiguous and have no gradient of its own")
