"""Displacements into the disk that a pair law's network sees, and its slopes back, by Triton.

What is a hundred small operations of torch's in a training step is four kernels on a card:
:func:`pair_gradient` stands for ``DisplacementPotential.plain_pair_gradient``, its twin. A
displacement d of soft length r is squashed by a = 1 / (REACH + r); the symmetric matrix
M = a I - (a^2 / r) d d^T is what that does to a small change of d, and so it is what turns slopes
back. The kernels run in Triton's interpreter too, on the CPU, which is how they are tested.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import torch
import triton
from torch import Tensor
from torch.autograd import Function

from dynamics.compiled import disk_kernel as kernels
from dynamics.compiled.shares import by_twin, of_models
from dynamics.potentials import SPREAD, soft_length, unsquashed

ROWS = 128  # displacements, in a program: one of each thread


def pair_gradient(gradient_of_rows: Callable[[Tensor], Tensor], displacement: Tensor) -> Tensor:
    """See :meth:`dynamics.potentials.DisplacementPotential.pair_gradient`.

    A derivative of the way back goes through the twin.

    Args:
        gradient_of_rows: the network's slopes at its inputs, ``(..., 2) -> (..., 2)``.
        displacement: at least one, ``(..., 2)``, float32.
    """
    rows = displacement.reshape(-1, 2)
    if not torch.is_grad_enabled():
        rows = rows.detach()
    slopes = gradient_of_rows(of_models(_Squashed, (), rows))
    return of_models(_Turned, (SPREAD / 2,), slopes, rows).reshape(displacement.shape)


class _Squashed(Function):
    """Of models along a first axis: displacements ``(models, rows, 2)`` become a network's inputs.

    These are ``(models, 2, rows, 2)``: the second half of them is the first, turned round.
    """

    @staticmethod
    def forward(ctx: Any, lengths: tuple[()], displacement: Tensor) -> Tensor:
        ctx.save_for_backward(displacement)
        d = displacement.detach().contiguous()
        models, rows, _ = d.shape
        out = d.new_empty(models, 2, rows, 2)
        _launch(kernels.squash, d, out)
        return out

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        return None, _Turned.apply((SPREAD,), upstream, *ctx.saved_tensors)


class _Turned(Function):
    """Of models along a first axis: ``scale * M (slopes[0] - slopes[1])``, ``(models, rows, 2)``.

    The slopes are ``(models, 2, rows, 2)``, and the displacements ``(models, rows, 2)``.
    """

    @staticmethod
    def forward(ctx: Any, lengths: tuple[float], slopes: Tensor, displacement: Tensor) -> Tensor:
        (ctx.scale,) = lengths
        ctx.save_for_backward(slopes, displacement)
        d, out = displacement.detach().contiguous(), displacement.new_empty(displacement.shape)
        _launch(kernels.turn, d, slopes.detach().contiguous(), out, ctx.scale)
        return out

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        slopes, displacement = ctx.saved_tensors
        if torch.is_grad_enabled():
            twin = partial(_plain_turned, ctx.scale)
            return None, *by_twin(twin, ctx.saved_tensors, upstream)
        given = displacement.contiguous(), slopes.contiguous(), upstream.contiguous()
        on_slopes, on_d = torch.empty_like(given[1]), torch.empty_like(given[0])
        _launch(kernels.turn_back, *given, on_slopes, on_d, ctx.scale)
        return None, on_slopes, on_d


def _plain_turned(scale: float, slopes: Tensor, displacement: Tensor) -> Tensor:
    slope = scale * (slopes[:, 0] - slopes[:, 1])
    return unsquashed(slope, displacement, soft_length(displacement))


def _launch(kernel: Any, displacement: Tensor, *given: Any) -> None:
    models, rows, _ = displacement.shape
    with torch.cuda.device_of(displacement):
        kernel[(triton.cdiv(rows, ROWS), models)](displacement, *given, rows, R=ROWS)
