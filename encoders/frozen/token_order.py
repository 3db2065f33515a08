"""Where a token of an unknown network stands: found by changing one patch of the input.

A network's embedding sees each patch by itself, so that one bright patch changes one token. From
three such patches follow the tokens that stand for no patch (class, registers: in front), and
whether rows or moments come first. What does not fit is refused, for features at wrong places would
be worse than none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

States = Callable[[Tensor], tuple[Tensor, ...]]
ORDERS = tuple(itertools.permutations("thw"))  # from the slowest to the fastest index


@dataclass(frozen=True)
class Grid:
    """Tokens along time and along the two sides of the image."""

    frames: int
    height: int
    width: int

    @property
    def cells(self) -> int:
        return self.frames * self.height * self.width


@dataclass(frozen=True)
class TokenOrder:
    """How hidden states become maps.

    Args:
        layers: hidden states beyond that of the embedding.
        grid: of the embedding's tokens or map.
        front: tokens before those of the patches.
        order: of time ``t``, rows ``h`` and columns ``w``, the slowest first.
        channels: axis of the channels where states are maps of one picture already; else 0.
    """

    layers: int
    grid: Grid
    front: int = 0
    order: tuple[str, ...] = ("t", "h", "w")
    channels: int = 0

    def maps(self, state: Tensor) -> Tensor:
        """``(n, tokens, k)``, or maps of one picture, to ``(n, t, k, h, w)``."""
        if self.channels:
            return state.movedim(self.channels, 1)[:, None]
        sizes = dict(zip("thw", (self.grid.frames, self.grid.height, self.grid.width), strict=True))
        tokens = state[:, self.front : self.front + self.grid.cells]
        cells = tokens.unflatten(1, tuple(sizes[axis] for axis in self.order))
        axes = [1 + self.order.index(axis) for axis in "thw"]
        return cells.permute(0, axes[0], 4, axes[1], axes[2])


def ask_order(name: str, states: States, blank: Tensor, blur: int = 0) -> TokenOrder:
    """Find out how a network orders its tokens.

    Args:
        name: of the network, for messages.
        states: from its pixels to all hidden states, that of the embedding first.
        blank: pixels as it takes them, ``(1, 3, H, W)`` or ``(1, f, 3, H, W)``.
        blur: frames on either side that an embedding lets in.

    Raises:
        ValueError: its tokens are in no order that is known here.
    """
    with torch.inference_mode():
        found = states(blank)
        first, layers = found[0], len(found) - 1
        for asked in _candidates(blank, first, layers):
            if _fits(states, blank, first, asked, blur):
                return asked
    raise ValueError(
        f"{name}: hidden states {tuple(first.shape)} are in no order that is known; register an "
        "encoder of your own for it"
    )


def _candidates(blank: Tensor, first: Tensor, layers: int) -> Iterator[TokenOrder]:
    """What the states of one clip may be, the likely first."""
    if first.ndim == 4:
        for axis, sides in ((1, first.shape[2:]), (3, first.shape[1:3])):
            yield TokenOrder(layers, Grid(1, *sides), channels=axis)
    elif first.ndim == 3:
        for grid, front in _grids(blank, first.shape[1]):
            for order in ORDERS:
                yield TokenOrder(layers, grid, front, order)


def _grids(blank: Tensor, tokens: int) -> list[tuple[Grid, int]]:
    """Grids of square patches that leave a few tokens over, the fewest first."""
    frames, side = (blank.shape[1] if blank.ndim == 5 else 1), blank.shape[-1]
    found = []
    for tubelet in (1, 2, 4, 8, 16):
        if frames % tubelet:
            continue
        times = frames // tubelet
        cells = math.isqrt(tokens // times)
        for across in range(cells, max(0, cells - 3), -1):
            left = tokens - times * across**2
            if side % across == 0 and 0 <= left <= 16:
                found.append((Grid(times, across, across), left))
    return sorted(found, key=lambda pair: pair[1])


def _fits(states: States, blank: Tensor, first: Tensor, asked: TokenOrder, blur: int) -> bool:
    """Whether bright patches at three unlike places change the tokens that stand for them."""
    grid = asked.grid
    for t, h, w in {
        (0, 0, grid.width - 1),
        (0, grid.height - 1, 0),
        (grid.frames - 1, 0, min(1, grid.width - 1)),
    }:
        changed = asked.maps(states(_lit(blank, grid, t, h, w))[0] - first)[0].norm(dim=1)
        most = torch.unravel_index(changed.argmax(), changed.shape)
        # an embedding whose patches overlap may change a neighbour more
        near = 2 if asked.channels else 0
        slack = max(near, blur), near, near
        off = (abs(int(a) - b) for a, b in zip(most, (t, h, w), strict=True))
        if changed.max() == 0 or any(x > most for x, most in zip(off, slack, strict=True)):
            return False
    return True


def _lit(blank: Tensor, grid: Grid, t: int, h: int, w: int) -> Tensor:
    pixels = blank.clone()
    down, across = blank.shape[-2] // grid.height or 1, blank.shape[-1] // grid.width or 1
    rows = slice(h * down, (h + 1) * down)
    columns = slice(w * across, (w + 1) * across)
    if blank.ndim == 5:
        span = blank.shape[1] // grid.frames
        pixels[:, t * span : (t + 1) * span, :, rows, columns] = 1
    else:
        pixels[..., rows, columns] = 1
    return pixels
