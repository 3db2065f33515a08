"""Whether fused loops can run: see :mod:`dynamics.compiled`, which needs numba."""

from __future__ import annotations

import torch
from torch import Tensor

from loops import has_numba


def fused_loops(states: Tensor, like: Tensor, fewest: int) -> bool:
    """Whether a rollout can run in fused loops on the CPU: no gradient is asked, numba is there.

    Args:
        states: q of the start, ``(..., n, d)``.
        like: a number of the model's, whose precision the states must have.
        fewest: episodes from which on it pays.
    """
    mapped = torch._C._functorch.peek_interpreter_stack() is not None
    plain = not (mapped or torch.is_grad_enabled() or torch.compiler.is_compiling())
    known = states.dtype in (torch.float32, torch.float64) and states.dtype == like.dtype
    enough = states.shape[:-2].numel() >= fewest and states.numel() > 0
    return plain and known and enough and states.device.type == "cpu" and has_numba()


def differentiable_loops(states: Tensor, like: Tensor, fewest: int) -> bool:
    """Whether a rollout can run in fused loops that have a way back; see :func:`fused_loops`.

    Rows are in single precision on the CPU, and models are mapped over at most once.
    """
    if states.device.type != "cpu" or torch.compiler.is_compiling() or not has_numba():
        return False
    stack = torch._C._functorch.get_interpreter_stack()
    plain = stack is None or [each.key().name for each in stack] == ["Vmap"]
    single = states.dtype == like.dtype == torch.float32
    return plain and single and states.shape[:-2].numel() >= fewest
