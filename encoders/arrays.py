"""What a feature store keeps of an entry, in NumPy: none of it needs torch until a model does.

NumPy has no bfloat16; here its values stand as their bits until somebody asks for numbers.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from encoders.quantised import EIGHT, Quantised

if TYPE_CHECKING:
    from torch import Tensor

    from encoders.features import FeatureMap

HALF = "bfloat16"
KEPT: dict[str, np.dtype[Any]] = {
    "float16": np.dtype("<f2"),
    HALF: np.dtype("<u2"),
    "float32": np.dtype("<f4"),
    EIGHT: np.dtype("i1"),
}
# of safetensors
NAMES = {"float16": "F16", HALF: "BF16", "float32": "F32", EIGHT: "I8", "float64": "F64"}
BESIDE = ("scale", "mean")  # float32 (t, c), of values in eight bits
NO_NUMBER = 0x7F80  # bits of the exponent, all set where a bfloat16 is not finite


@dataclass(frozen=True)
class FeatureArrays:
    """Features of one clip, as :class:`encoders.FeatureMap` has them of several.

    Args:
        values: ``(t, c, h, w)``, float16 or float32; bfloat16 and int8 are read as float32.
        stride: pixels of the frames between neighbouring cells, as there.
        times: seconds, ``(t,)``.
    """

    values: np.ndarray
    stride: tuple[float, ...]
    times: np.ndarray


@dataclass(frozen=True)
class Mapped:
    """The tensors of one entry where they lie on disk.

    Args:
        values: ``(t, c, h, w)``, of a type of :data:`KEPT`.
        dtype: what they mean.
        times: seconds, ``(t,)``.
        beside: what else there is of values in eight bits, by the names in :data:`BESIDE`.
    """

    values: np.ndarray
    dtype: str
    times: np.ndarray
    beside: Mapping[str, np.ndarray] = field(default_factory=dict)

    def arrays(self, stride: Sequence[float]) -> FeatureArrays:
        """For NumPy."""
        values = numbers(self.values) if self.dtype == HALF else self._plain()
        return FeatureArrays(values, tuple(stride), self.times)

    def features(self, stride: Sequence[float]) -> FeatureMap:
        """For torch, memory-mapped still; but for eight bits, which become float32 in memory."""
        import torch

        from encoders.features import FeatureMap

        values = torch.from_numpy(self._plain())
        if self.dtype == HALF:
            values = values.view(torch.bfloat16)
        return FeatureMap(values[None], tuple(stride), torch.from_numpy(self.times))

    def _plain(self) -> np.ndarray:
        if self.dtype == EIGHT:
            return Quantised(self.values, **self.beside).numbers()
        return self.values


def mapped(file: Path, place: int, size: int) -> np.ndarray:
    """Bytes of a file as they lie there; what is changed of them is changed in memory only.

    Raises:
        OSError, ValueError: the file does not have them.
    """
    return np.memmap(file, np.uint8, "c", place, (size,))


def tensors_in(data: np.ndarray) -> Mapped:
    """The tensors of an entry in its bytes, which are those that were written."""
    begin = 8 + int.from_bytes(data[:8].tobytes(), "little")
    about = json.loads(data[8:begin].tobytes())
    dtype = next(name for name, short in NAMES.items() if short == about["values"]["dtype"])
    clock = np.dtype("<f4" if about["times"]["dtype"] == NAMES["float32"] else "<f8")
    held = data[begin:].view(np.ndarray)

    def tensor(name: str, kind: np.dtype[Any]) -> np.ndarray:
        return held[slice(*about[name]["data_offsets"])].view(kind).reshape(about[name]["shape"])

    beside = {name: tensor(name, KEPT["float32"]) for name in BESIDE if name in about}
    return Mapped(tensor("values", KEPT[dtype]), dtype, tensor("times", clock), beside)


def header(times: np.ndarray, dtype: str, grid: Sequence[int]) -> bytes:
    """What safetensors writes before ``times (t,)`` and ``values (t, *grid)``.

    Eight bits are followed by what is :data:`BESIDE` them, which is known at the end only.
    """
    count, about, place = len(times), dict[str, Any](), 0
    tensors = [("times", times.dtype.name, [count]), ("values", dtype, [count, *grid])]
    if dtype == EIGHT:
        tensors += [(name, "float32", [count, grid[0]]) for name in BESIDE]
    for name, kind, shape in tensors:
        begun, place = place, place + np.dtype(KEPT.get(kind, kind)).itemsize * math.prod(shape)
        about[name] = {"dtype": NAMES[kind], "shape": shape, "data_offsets": [begun, place]}
    text = json.dumps(about, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def bytes_kept(shape: Sequence[int], dtype: str) -> int:
    """Of values ``(..., c, h, w)`` in a type of :data:`KEPT`, with what is beside them.

    Example:
        >>> bytes_kept((3, 8, 8), "float16"), bytes_kept((3, 8, 8), "int8")
        (384, 216)
    """
    beside = len(BESIDE) * KEPT["float32"].itemsize if dtype == EIGHT else 0
    return math.prod(shape) * KEPT[dtype].itemsize + math.prod(shape[:-2]) * beside


def fewer_cells(maps: np.ndarray, most: int) -> np.ndarray:
    """The means over blocks of cells, ``most`` blocks on a side at most.

    Args:
        maps: ``(..., h, w)``.
        most: blocks may share a row or a column of cells, where it does not divide them evenly.

    Example:
        >>> fewer_cells(np.arange(12.0).reshape(3, 4), 2).tolist()
        [[2.5, 4.5], [6.5, 8.5]]
    """
    height, width = maps.shape[-2:]
    if max(height, width) <= most:
        return maps
    rows, columns = _blocks(height, most), _blocks(width, most)
    weights = np.kron(rows, columns).T.astype(maps.dtype)
    means = maps.reshape(-1, height * width) @ weights
    return means.reshape(*maps.shape[:-2], len(rows), len(columns))


def _blocks(cells: int, most: int) -> np.ndarray:
    """What each cell of a side weighs in the mean of each block, ``(blocks, cells)``."""
    blocks = min(cells, most)
    weights = np.zeros((blocks, cells))
    for k, block in enumerate(weights):
        begin, end = k * cells // blocks, -(-(k + 1) * cells // blocks)
        block[begin:end] = 1 / (end - begin)
    return weights


def as_times(times: Tensor | np.ndarray) -> np.ndarray:
    """Seconds, as they are kept."""
    return np.ascontiguousarray(times if isinstance(times, np.ndarray) else times.cpu().numpy())


def as_kept(piece: Tensor | np.ndarray, dtype: str) -> np.ndarray | None:
    """Values of an array or a tensor in a type of floats; ``None`` where it cannot hold them.

    Example:
        >>> as_kept(np.array([1.0, 3.0]), "bfloat16").tolist(), as_kept(np.array([1e6]), "float16")
        ([16256, 16448], None)
    """
    if not isinstance(piece, np.ndarray):
        import torch

        cast = piece.detach().to(getattr(torch, dtype)).contiguous()
        if not bool(torch.isfinite(cast).all()):
            return None
        raw = cast.reshape(-1).view(torch.uint8).cpu().numpy()
        return raw.view(KEPT[dtype]).reshape(cast.shape)
    if dtype == HALF:
        kept = _bits(piece)
        return None if bool(((kept & NO_NUMBER) == NO_NUMBER).any()) else kept
    with np.errstate(over="ignore"):  # which is what is looked for
        kept = np.ascontiguousarray(piece, KEPT[dtype])
    return kept if bool(np.isfinite(kept).all()) else None


def numbers(bits: np.ndarray) -> np.ndarray:
    """Float32 of the bits of bfloat16, exactly."""
    return (bits.astype("<u4") << 16).view("<f4")


def _bits(values: np.ndarray) -> np.ndarray:
    """Of bfloat16, to the nearest, halves to the even one; what is not finite stays so."""
    plain = np.ascontiguousarray(values, "<f4")
    whole = plain.view("<u4")
    rounded = (whole + (0x7FFF + (whole >> 16 & 1)).astype("<u4")) >> 16
    return np.where(np.isfinite(plain), rounded, NO_NUMBER).astype("<u2")
