"""The input gradient of a tanh network by torch's operations, which fused loops are held to."""

from __future__ import annotations

import torch
from torch import Tensor


def plain_gradient(
    x: Tensor, first: Tensor, first_bias: Tensor, square: Tensor, bias: Tensor, last: Tensor
) -> Tensor:
    """See :func:`dynamics.compiled.gradient.input_gradient`; it can be differentiated again."""
    low = torch.tanh(x @ first.mT + first_bias.unsqueeze(-2))
    top = torch.tanh(low @ square.mT + bias.unsqueeze(-2))
    return ((last * (1 - top.square())) @ square * (1 - low.square())) @ first
