"""Readouts of any target from feature frames, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from vidphys.probing.controls import POOLED
from vidphys.probing.linear import Predictions, read_linearly, seen_as

LINEAR, LOCAL, ATTENTION = "linear", "local", "attention"
READOUTS = {
    LINEAR: "a ridge regression on all cells of the map",
    POOLED: "a ridge regression on the mean over all cells",
    ATTENTION: "queries that attend over the cells, trained; minutes a layer",
    LOCAL: "a ridge regression on the features at each body's true place",
}


class Readout(Protocol):
    """Maps to predictions of several targets, each clip by what did not see it."""

    def __call__(
        self,
        maps: Tensor,
        targets: Sequence[np.ndarray],
        known: Sequence[np.ndarray],
        clips: np.ndarray,
        folds: np.ndarray,
        seed: int,
        controls: bool,
    ) -> list[Predictions]:
        """See :func:`vidphys.probing.linear.read_linearly`.

        Args:
            maps: ``(e, c, h, w)``.
            targets: ``(e, k, m)`` each, see :mod:`vidphys.probing.coding`.
        """
        ...


@dataclass(frozen=True)
class Linear(Readout):
    """A ridge regression on all cells, or on what lies at some places.

    Where places are given, one regression serves all bodies: what is told of one is read from its
    place alone, by the same weights. A target that has not a value for each body is read from all
    places side by side.

    Args:
        places: of each body in each example, ``(e, n, 2)``, x and y of -1 to 1 over the image's
            width and height, y upwards; all cells are read where not given.
        pooled: read the mean over all cells.
    """

    places: Tensor | None = None
    pooled: bool = False

    def __call__(
        self,
        maps: Tensor,
        targets: Sequence[np.ndarray],
        known: Sequence[np.ndarray],
        clips: np.ndarray,
        folds: np.ndarray,
        seed: int,
        controls: bool,
    ) -> list[Predictions]:
        maps = maps if self.places is None else at_places(maps, self.places)
        maps = pooled(maps) if self.pooled else maps
        bodies = 1 if self.places is None else self.places.shape[1]
        found: list[Predictions | None] = [None] * len(targets)
        for count in {1, bodies}:
            mine = [k for k, t in enumerate(targets) if _bodies(t, bodies) == count]
            if mine:
                said = read_linearly(
                    seen_as(_by_body(maps) if count > 1 else maps),
                    [targets[k].reshape(len(targets[k]) * count, -1) for k in mine],
                    [known[k].repeat(count) for k in mine],
                    clips.repeat(count),
                    folds,
                    seed,
                    controls,
                )
                for k, each in zip(mine, said, strict=True):
                    found[k] = each.shaped(targets[k].shape)
        return [each for each in found if each is not None]


def _bodies(target: np.ndarray, bodies: int) -> int:
    """How many bodies have columns ``(e, k, m)`` of their own."""
    return bodies if target.shape[1] % bodies == 0 else 1


def _by_body(maps: Tensor) -> Tensor:
    """``(e, c, n, 1)`` with each body as an example, ``(e * n, c, 1, 1)``."""
    return maps.movedim(2, 1).flatten(0, 1)[..., None]


def pooled(maps: Tensor) -> Tensor:
    """The mean over all cells, as maps of one cell."""
    return maps.float().mean((-2, -1), keepdim=True)


def at_places(
    maps: Float[Tensor, "e c h w"], places: Float[Tensor, "e n 2"]
) -> Float[Tensor, "e c n 1"]:
    """Features at places within the maps, between cells by the four around; see :class:`Linear`.

    Example:
        >>> ramp = torch.arange(4.0).reshape(1, 1, 1, 4).expand(1, 1, 4, 4)
        >>> at_places(ramp, torch.tensor([[[0.0, 0.0], [0.25, 0.9]]])).flatten().tolist()
        [1.5, 2.0]
    """
    grid = places.float() * torch.tensor([1.0, -1.0])
    return functional.grid_sample(
        maps.float(), grid[:, :, None], padding_mode="border", align_corners=False
    )
