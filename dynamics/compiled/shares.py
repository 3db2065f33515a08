"""Work on several models side by side, shared among threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from dynamics.compiled.lanes import Array
from loops.threads import in_threads

Some = tuple[int, int]  # tiles, from one up to another


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
