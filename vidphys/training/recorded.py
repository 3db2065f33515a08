"""The loss of a batch and its gradient on a card, recorded; see :mod:`dynamics.compiled.graphs`.

Only tensors of the card are in a recording: each batch is copied to where the first one lay. A loss
that reads a number of the card while it is computed, or takes one there, cannot be recorded, and
the card says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from dynamics.compiled.graphs import apart, recorded
from vidphys.placement import mapped

WARM_UP = 3  # runs before the recording, in which libraries choose and set up their kernels


class Recording:
    """A loss and its gradient, for batches of the shapes of the first.

    Args:
        loss: a scalar from one batch, by operations on the card alone.
        parameters: of the model; their gradients are the recording's own memory from now on.
        batch: the first one, on the card.

    Raises:
        RuntimeError: the loss cannot be recorded; it can still be computed as it is.
    """

    def __init__(
        self, loss: Callable[[Any], Tensor], parameters: Sequence[nn.Parameter], batch: Any
    ) -> None:
        self.batch = mapped(Tensor.clone, batch)

        def work() -> Tensor:
            forget(parameters)  # which makes the recorded gradients new ones, not sums
            value = loss(self.batch)
            value.backward()
            gradients = [p.grad for p in parameters if p.grad is not None]
            largest = nn.utils.get_total_norm(gradients, math.inf)
            return torch.stack([value.detach(), largest])

        apart(work, WARM_UP)
        self.play = recorded(work)
        self.gradients = [(p, p.grad) for p in parameters]

    def __call__(self, batch: Any) -> tuple[float, float]:
        """Loss and largest gradient of a batch; the parameters then have their gradients.

        Raises:
            RuntimeError: the batch is of other shapes.
        """
        kept, given = tensors(self.batch), tensors(batch)
        if [(x.shape, x.dtype) for x in kept] != [(x.shape, x.dtype) for x in given]:
            raise RuntimeError("a recorded step is for batches of one shape")
        torch._foreach_copy_(kept, given)
        found = self.play()
        for parameter, gradient in self.gradients:
            parameter.grad = gradient
        loss, largest = found.tolist()
        return loss, largest


def tensors(tree: Any) -> list[Tensor]:
    """All tensors of a tree, in its order; see :func:`vidphys.placement.mapped`."""
    found: list[Tensor] = []

    def kept(x: Tensor) -> Tensor:
        found.append(x)
        return x

    mapped(kept, tree)
    return found


def forget(parameters: Sequence[nn.Parameter]) -> None:
    """Leave the parameters without gradients."""
    for parameter in parameters:
        parameter.grad = None
