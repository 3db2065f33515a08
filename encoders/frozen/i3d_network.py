"""Inception-v1 inflated to three dimensions (I3D; Carreira and Zisserman, arXiv:1705.07750).

Parameters are named as in the widely used PyTorch port. Paddings are TensorFlow's "SAME": they
depend on the size, and where they are odd the larger part comes last, so that a unit's receptive
field is not centred on the cell that it stands for; :func:`field_centre` says where it is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

Triple = tuple[int, int, int]

# per mixed stage: input channels, then those of the branches 1x1; 1x1, 3x3; 1x1, 3x3; pool, 1x1
MIXED = {
    "Mixed_3b": (192, 64, 96, 128, 16, 32, 32),
    "Mixed_3c": (256, 128, 128, 192, 32, 96, 64),
    "Mixed_4b": (480, 192, 96, 208, 16, 48, 64),
    "Mixed_4c": (512, 160, 112, 224, 24, 64, 64),
    "Mixed_4d": (512, 128, 128, 256, 24, 64, 64),
    "Mixed_4e": (512, 112, 144, 288, 32, 64, 64),
    "Mixed_4f": (528, 256, 160, 320, 32, 128, 128),
    "Mixed_5b": (832, 256, 160, 320, 32, 128, 128),
    "Mixed_5c": (832, 384, 192, 384, 48, 128, 128),
}
# kernel and stride (time, height, width) of the layers that stride, by the stage they come before
POOLS: dict[str, tuple[Triple, Triple]] = {
    "Conv3d_2b_1x1": ((1, 3, 3), (1, 2, 2)),
    "Mixed_3b": ((1, 3, 3), (1, 2, 2)),
    "Mixed_4b": ((3, 3, 3), (2, 2, 2)),
    "Mixed_5b": ((2, 2, 2), (2, 2, 2)),
}
STEM: tuple[Triple, Triple] = ((7, 7, 7), (2, 2, 2))
STAGES = ("Conv3d_1a_7x7", "Conv3d_2b_1x1", "Conv3d_2c_3x3", *MIXED)


class Unit(nn.Module):
    """Convolution, batch normalisation, ReLU."""

    def __init__(self, channels: int, out: int, kernel: Triple, stride: Triple = (1, 1, 1)) -> None:
        super().__init__()
        self.conv3d = nn.Conv3d(channels, out, kernel, stride, bias=False)
        self.bn = nn.BatchNorm3d(out, eps=1e-3)

    def forward(self, x: Tensor) -> Tensor:
        kernel, stride = self.conv3d.kernel_size, self.conv3d.stride
        return torch.relu(self.bn(self.conv3d(_same(x, kernel, stride))))


class Mixed(nn.Module):
    """Four branches side by side."""

    def __init__(self, channels: int, widths: tuple[int, ...]) -> None:
        super().__init__()
        one, three = (1, 1, 1), (3, 3, 3)
        self.b0 = Unit(channels, widths[0], one)
        self.b1a = Unit(channels, widths[1], one)
        self.b1b = Unit(widths[1], widths[2], three)
        self.b2a = Unit(channels, widths[3], one)
        self.b2b = Unit(widths[3], widths[4], three)
        self.b3b = Unit(channels, widths[5], one)

    def forward(self, x: Tensor) -> Tensor:
        pooled = pool(x, (3, 3, 3), (1, 1, 1))
        branches = [self.b0(x), self.b1b(self.b1a(x)), self.b2b(self.b2a(x)), self.b3b(pooled)]
        return torch.cat(branches, 1)


class I3DNetwork(nn.Module):
    """The stages up to ``Mixed_5c``, without a classifier."""

    def __init__(self) -> None:
        super().__init__()
        self.add_module("Conv3d_1a_7x7", Unit(3, 64, *STEM))
        self.add_module("Conv3d_2b_1x1", Unit(64, 64, (1, 1, 1)))
        self.add_module("Conv3d_2c_3x3", Unit(64, 192, (3, 3, 3)))
        for name, (channels, *widths) in MIXED.items():
            self.add_module(name, Mixed(channels, tuple(widths)))

    def forward(self, x: Tensor, stages: tuple[str, ...]) -> list[Tensor]:
        """``(n, 3, t, h, w)`` in [-1, 1] to the maps of some stages, in their order.

        None after the last of them is computed.
        """
        found = []
        for name, module in self.named_children():
            if name in POOLS:
                x = pool(x, *POOLS[name])
            x = module(x)
            if name in stages:
                found.append(x)
            if name == stages[-1]:
                break
        return found


def field_stride(stage: str, axis: int) -> int:
    """Input cells between neighbouring units of a stage; axes are time, height, width."""
    stride = 1
    for _, step in _striding(stage):
        stride *= step[axis]
    return stride


def field_centre(stage: str, axis: int) -> float:
    """Number of the input cell that the first unit of a stage is centred on.

    It holds for sizes that are multiples of :func:`field_stride`.
    """
    stride, centre = 1, 0.0
    for kernel, step in _striding(stage):
        front = max(kernel[axis] - step[axis], 0) // 2
        centre += stride * ((kernel[axis] - 1) / 2 - front)
        stride *= step[axis]
    return centre


def _striding(stage: str) -> list[tuple[Triple, Triple]]:
    before = STAGES[: STAGES.index(stage) + 1]
    return [STEM, *(layer for name, layer in POOLS.items() if name in before)]


def _same(x: Tensor, kernel: tuple[int, ...], stride: tuple[int, ...]) -> Tensor:
    pads: list[int] = []
    for size, k, s in zip(x.shape[2:], kernel, stride, strict=True):
        missing = max((-(-size // s) - 1) * s + k - size, 0)
        pads = [missing // 2, missing - missing // 2, *pads]
    return functional.pad(x, pads) if any(pads) else x


def pool(x: Tensor, kernel: Triple, stride: Triple) -> Tensor:
    """The maximum, one axis after the other: the same numbers, several times faster on a CPU.

    Args:
        x: ``(n, c, t, h, w)``, nowhere below zero.
        kernel: along time, height, width.
        stride: the same.
    """
    # what is padded has passed a ReLU: zeros are never above the maximum
    x = _same(x, kernel, stride)
    for axis, (width, step) in enumerate(zip(kernel, stride, strict=True), start=2):
        if width > 1:
            x = x.unfold(axis, width, step).amax(-1)
    return x
