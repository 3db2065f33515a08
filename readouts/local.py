"""Positions read twice: roughly by attention over the whole map, then from the cells around.

Attention averages what it looks at; where one body half hides another, the arrangement of the
cells around them says how far. The second reading is the same network at every place.
"""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn import functional

from readouts.attention import UNSURE, AttentionReadout, confidence_at, nearest
from readouts.base import FrameReadout
from readouts.scale import FeatureScale

SIGHT = 0.125  # normalised image units that cells are read on each side, if not less than a cell
CODE = 32  # numbers that a cell's features are brought down to
WIDTH = 256
COARSE = 16  # cells a side that attention chooses from
AGREED = 1e-4  # normalised image units; readers nearer to each other than this agree
LOOKS = 2  # readings from the cells around, each at the place that the one before gave


class CellReader(nn.Module):
    """Where in the middle of some cells each body is, from the features of all of them.

    Args:
        channels: of the features.
        bodies: positions in a feature frame; each has an output, and a mark in the hidden layer.
        cells: that are read.
    """

    def __init__(self, channels: int, bodies: int, cells: int) -> None:
        super().__init__()
        self.code = nn.Linear(channels, CODE)
        self.around = nn.Linear(CODE * cells, WIDTH)
        self.body = nn.Parameter(torch.randn(bodies, WIDTH) / 2)
        self.mix = nn.Linear(WIDTH, WIDTH)
        self.place = nn.Parameter(torch.randn(bodies, WIDTH, 2) / (10 * WIDTH**0.5))

    def forward(
        self, seen: Float[Tensor, "f n k k c"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n hidden"]]:
        """Offsets from the middle cell's centre, in cells, and what they were read from."""
        codes = functional.gelu(self.code(seen)).flatten(-3)
        hidden = functional.gelu(self.around(codes) + self.body)
        hidden = hidden + functional.gelu(self.mix(hidden))
        return torch.einsum("fnk,nkd->fnd", hidden, self.place), hidden


class LocalReadout(nn.Module):
    """Where a body is, from the features of the cells around a place near it.

    Args:
        scale: of the features.
        bodies: positions in a feature frame.
        reach: cells that are read on each side.
        readers: of the same cells. Where examples were few they differ, so that their mean is
            nearer than each of them, and their spread a reason for doubt.
    """

    def __init__(self, scale: FeatureScale, bodies: int, reach: int, readers: int = 1) -> None:
        super().__init__()
        self.reach, self.scale = reach, scale
        channels, cells = len(scale.mean), (2 * reach + 1) ** 2
        self.readers = nn.ModuleList(CellReader(channels, bodies, cells) for _ in range(readers))

    def forward(
        self,
        values: Float[Tensor, "f c h w"],
        centres: Float[Tensor, "h w 2"],
        near: Float[Tensor, "f n 2"],
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n k"]]:
        """Mean positions of the readers, and what speaks for and against them.

        Args:
            values: features of frames.
            centres: of the cells, normalised image units.
            near: places to look at, normalised image units.
        """
        cells = nearest_cells(near, centres)
        frames = torch.arange(len(values), device=values.device)
        positions, hidden = self.read(self.cut(values, frames, cells), cells, centres)
        spread = positions.var(0, correction=0).sum(-1, keepdim=True)
        evidence = torch.cat([hidden[0], (spread + AGREED**2).sqrt().log()], -1)
        return positions.mean(0), evidence

    def read(
        self,
        seen: Float[Tensor, "f n k k c"],
        cells: Int[Tensor, "f n 2"],
        centres: Float[Tensor, "h w 2"],
    ) -> tuple[Float[Tensor, "r f n 2"], Float[Tensor, "r f n hidden"]]:
        """Position and hidden layer of each reader, from what :meth:`cut` gave.

        Args:
            seen: around the cells.
            cells: (row, column) of each.
            centres: of all cells, normalised image units.
        """
        offsets, hidden = zip(*(reader(seen) for reader in self.readers), strict=True)
        step = (centres[1, 1] - centres[0, 0]).abs()
        middle = centres[cells[..., 0], cells[..., 1]]
        return middle + step * torch.stack(offsets), torch.stack(hidden)

    def cut(
        self,
        values: Float[Tensor, "m c h w"],
        frames: Int[Tensor, " f"],
        cells: Int[Tensor, "f n 2"],
    ) -> Float[Tensor, "f n k k c"]:
        """Standardised features around cells of some frames, on the readout's own device.

        Zero beyond the border. Many frames may lie elsewhere: what is cut out of them is moved.
        """
        h, w = values.shape[-2:]
        step = torch.arange(-self.reach, self.reach + 1, device=cells.device)
        rows, columns = cells[..., :1] + step, cells[..., 1:] + step
        inside = ((rows >= 0) & (rows < h))[..., :, None] & ((columns >= 0) & (columns < w))[
            ..., None, :
        ]
        rows, columns = rows.clamp(0, h - 1)[..., :, None], columns.clamp(0, w - 1)[..., None, :]
        found, where = values[frames[:, None, None, None], :, rows, columns], self.scale.mean.device
        return self.scale(found.to(where)) * inside.unsqueeze(-1).to(where)


class RefinedReadout(FrameReadout):
    """Attention, then :data:`LOOKS` readings from the cells around the place that it gave.

    Args:
        channels: of the feature map.
        bodies: positions in a feature frame.
        grid: cells (height, width) of the maps; attention reads them averaged over blocks, down to
            :data:`COARSE` a side.
        frames: of the clip that a feature frame stands for; see :class:`AttentionReadout`.
        readers: see :class:`LocalReadout`.

    Example:
        >>> readout = RefinedReadout(channels=16, bodies=3, grid=(8, 8))
        >>> centres = torch.rand(8, 8, 2)
        >>> positions, sure = readout.read(torch.randn(5, 16, 8, 8), centres)
        >>> tuple(positions.shape), tuple(sure.shape)
        ((5, 3, 2), (5, 3))
    """

    def __init__(
        self,
        channels: int,
        bodies: int,
        grid: tuple[int, int],
        frames: int = 1,
        readers: int = 1,
    ) -> None:
        super().__init__()
        self.frames, longer = frames, max(grid)
        self.block = max(1, longer // COARSE)
        self.coarse = AttentionReadout(channels, bodies, frames=frames)
        reach = max(1, round(SIGHT * longer / 2))
        self.local = LocalReadout(self.coarse.scale, bodies, reach, readers)
        self.doubt = nn.Sequential(
            nn.Linear(WIDTH + 2, WIDTH // 4), nn.GELU(), nn.Linear(WIDTH // 4, 1), nn.Softplus()
        )

    def read(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n"]]:
        """See :class:`readouts.base.Readout`."""
        position, evidence = self.look(values, centres)
        return position, confidence_at(self.expected(evidence))

    def look(
        self, values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"]
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n k"]]:
        """Positions, and what their expected error is judged by."""
        position, _ = self.coarse.look(*blocks(values, centres, self.block))
        for _ in range(LOOKS):
            position, evidence = self.local(values, centres, position)
        frames = position.unflatten(1, (self.frames, -1)).flatten(0, 1)
        apart = nearest(frames).reshape(*position.shape[:2], 1)
        return position, torch.cat([evidence, apart], -1)

    def expected(self, evidence: Float[Tensor, "*n k"]) -> Float[Tensor, "*n"]:
        """Distance from the truth that is expected of positions, normalised image units."""
        return (UNSURE * self.doubt(evidence).squeeze(-1)).square()


def blocks(
    values: Float[Tensor, "f c h w"], centres: Float[Tensor, "h w 2"], block: int
) -> tuple[Float[Tensor, "f c y x"], Float[Tensor, "y x 2"]]:
    """Features and cell centres averaged over blocks of so many cells a side."""
    if block == 1:
        return values, centres
    middle = functional.avg_pool2d(centres.movedim(-1, 0), block).movedim(0, -1)
    return functional.avg_pool2d(values.float(), block), middle


def nearest_cells(
    near: Float[Tensor, "f n 2"], centres: Float[Tensor, "h w 2"]
) -> Int[Tensor, "f n 2"]:
    """(row, column) of the cell that is nearest to each place."""
    column = (near[..., 0, None] - centres[0, :, 0]).abs().argmin(-1)
    row = (near[..., 1, None] - centres[:, 0, 1]).abs().argmin(-1)
    return torch.stack([row, column], -1)
