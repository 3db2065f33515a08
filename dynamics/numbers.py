"""A number of a module that is either learned or fixed, and known to whoever looks for it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn


def number(
    module: nn.Module,
    name: str,
    value: float | Sequence[float] | Sequence[Sequence[float]],
    learned: bool,
) -> None:
    """Give a module a number, or several: a parameter that starts there, or a fixed buffer.

    Args:
        module: that holds it.
        name: of the attribute.
        value: in the module's own unit.
        learned: whether training may change it.
    """
    if learned:
        module.register_parameter(name, nn.Parameter(torch.tensor(value)))
    else:
        module.register_buffer(name, torch.tensor(value, dtype=torch.float64))


def unbent(value: float) -> Tensor:
    """Inverse of softplus, where exp overflows too; minus infinity for none."""
    there = torch.tensor(value, device="cpu")
    return there + torch.log(-torch.expm1(-there))
