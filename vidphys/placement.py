"""Where tensors are. What learns is on the device that was asked for; data and truth on the CPU.

A model's own device says where it computes. What it is given is taken there, and what it answers
comes back, at a few doors: the batch of a training step, a head's rollout, a perception's look at
clips. All else (scenes, references, metrics, records) is float64 on the CPU, whatever the device.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

T = TypeVar("T")
CPU = torch.device("cpu")


def device_of(module: nn.Module) -> torch.device:
    """Where a model computes: where its weights are, or its buffers; else the CPU."""
    for tensor in (*module.parameters(), *module.buffers()):
        return tensor.device
    return CPU


def moved(tree: T, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> T:
    """The same with all its tensors on a device, and its floating-point ones in a precision.

    Args:
        tree: see :func:`mapped`.
        device: where to; ``None`` leaves each where it is.
        dtype: of floating-point numbers; ``None`` keeps that of each.

    Example:
        >>> moved({"index": torch.arange(2), "x": torch.ones(1)}, "cpu", torch.float64)
        {'index': tensor([0, 1]), 'x': tensor([1.], dtype=torch.float64)}
    """
    return mapped(lambda x: x.to(device, dtype if x.is_floating_point() else None), tree)


def mapped(function: Callable[[Tensor], Tensor], tree: T) -> T:
    """The same with a function of each of its tensors in the tensor's place.

    Args:
        function: is called in the order of the tree.
        tree: a tensor, or a dataclass, tuple, list or mapping of such; what else is in it stays.
    """
    whole: Any = tree
    if isinstance(whole, Tensor):
        return function(whole)  # type: ignore[return-value]
    if isinstance(whole, tuple):
        parts = [mapped(function, part) for part in whole]
        return type(whole)(*parts) if hasattr(whole, "_fields") else type(whole)(parts)  # type: ignore[return-value]
    if isinstance(whole, list):
        return [mapped(function, part) for part in whole]  # type: ignore[return-value]
    if isinstance(whole, Mapping):
        return {key: mapped(function, part) for key, part in whole.items()}  # type: ignore[return-value]
    if is_dataclass(whole) and not isinstance(whole, type):
        other = copy.copy(whole)  # no check is run again
        for field in fields(whole):
            object.__setattr__(other, field.name, mapped(function, getattr(whole, field.name)))
        return other  # type: ignore[return-value]
    return tree


def suited(tree: T, model: nn.Module) -> T:
    """The same on a model's device and in its precision: float64 for one without weights."""
    dtype = next((p.dtype for p in model.parameters()), torch.float64)
    return moved(tree, device_of(model), dtype)
