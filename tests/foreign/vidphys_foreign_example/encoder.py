"""An image encoder without weights: brightness and its slopes, cell by cell."""

import torch
from torch import Tensor
from torch.nn import functional

from encoders import FeatureMap


class Edges:
    """Each cell's mean colour, mean slopes and mean size of the slopes.

    Args:
        cell: pixels on a side.
    """

    code_version = 1

    def __init__(self, cell: int = 4) -> None:
        self.cell = int(cell)

    def __call__(self, frames: Tensor, times: Tensor) -> FeatureMap:
        light = frames.flatten(0, 1)
        padded = functional.pad(light, (1, 1, 1, 1), mode="replicate")
        along_x = (padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]) / 2
        along_y = (padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]) / 2
        size = (along_x.square() + along_y.square()).sqrt()
        maps = torch.cat([light, along_x, along_y, size], 1)
        values = functional.avg_pool2d(maps, self.cell).unflatten(0, frames.shape[:2])
        return FeatureMap(values, (float(self.cell), float(self.cell)), times)
