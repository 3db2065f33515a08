"""Functions of several models side by side: how they are called, shared among threads, and undone.

A function's parts are tensors of models along a first axis; its ``lengths`` are plain numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from loops.threads import in_threads

if TYPE_CHECKING:
    from dynamics.compiled.lanes import Array

Some = tuple[int, int]  # tiles, from one up to another


def of_models(function: type[Function], lengths: tuple[Any, ...], *parts: Tensor) -> Tensor:
    """``function(lengths, *parts)`` of one model's parts, or of all that are mapped over."""
    if torch._C._functorch.peek_interpreter_stack() is not None:
        return _Mapped.apply(function, lengths, *parts)
    return function.apply(lengths, *(x.unsqueeze(0) for x in parts)).squeeze(0)


class _Mapped(Function):
    """A function of one model; of several that are mapped over, each with its own weights."""

    @staticmethod
    def forward(function: type[Function], lengths: tuple[Any, ...], *parts: Tensor) -> Tensor:
        return of_models(function, lengths, *parts)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
        """Nothing is kept here: what :meth:`vmap` calls has its own way back."""

    @staticmethod
    def vmap(
        info: Any,
        dims: tuple[Any, ...],
        function: type[Function],
        lengths: tuple[Any, ...],
        *parts: Tensor,
    ) -> tuple[Tensor, int]:
        """All models in one call."""
        each = (
            part.expand(info.batch_size, *part.shape) if dim is None else part.movedim(dim, 0)
            for part, dim in zip(parts, dims[2:], strict=True)
        )
        return function.apply(lengths, *each), 0


def by_twin(
    twin: Callable[..., Tensor], given: Sequence[Tensor], upstream: Tensor
) -> list[Tensor | None]:
    """The way back of ``twin(*given)``, in plain torch: another derivative can go through it."""
    again = torch.is_grad_enabled()
    needed = [tensor for tensor in given if tensor.requires_grad]
    with torch.enable_grad():
        found = torch.autograd.grad(twin(*given), needed, upstream, create_graph=again)
    left = iter(found)
    return [next(left) if tensor.requires_grad else None for tensor in given]


def shares(which: Some, tiles: int) -> Iterator[tuple[int, Some]]:
    """Each model's tiles of some of all models' tiles."""
    begin, end = which
    while begin < end:
        model = begin // tiles
        stop = min(end, (model + 1) * tiles)
        yield model, (begin - model * tiles, stop - model * tiles)
        begin = stop


def on_weights(
    nets: Sequence[Any],
    tiles: int,
    back: Callable[[int, Some, Any], None],
    in_torchs_form: Callable[[list[Any]], list[Array]],
) -> Iterator[Tensor]:
    """Gradients of the weights of models with as many tiles each, models along the first axis.

    Args:
        nets: each model's weights, a named tuple of arrays.
        tiles: of each model.
        back: adds what some tiles of a model say of its weights to such a tuple.
        in_torchs_form: of one model, what several threads found together.
    """

    def part(which: Some) -> list[tuple[int, Any]]:
        found = []
        for model, some in shares(which, tiles):
            total = type(nets[model])(*(np.zeros_like(w) for w in nets[model]))
            back(model, some, total)
            found.append((model, total))
        return found

    totals: list[list[Any]] = [[] for _ in nets]
    for found in in_threads(part, len(nets) * tiles):
        for model, total in found:
            totals[model].append(total)
    each = (in_torchs_form(total) for total in totals)
    return (torch.from_numpy(np.array(w)) for w in zip(*each, strict=True))
