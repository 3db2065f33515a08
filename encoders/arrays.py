"""What a feature store keeps of an entry, in NumPy: none of it needs torch until a model does.

NumPy has no bfloat16; here its values stand as their bits until somebody asks for numbers.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

    from encoders.features import FeatureMap

HALF = "bfloat16"
KEPT: dict[str, np.dtype[Any]] = {
    "float16": np.dtype("<f2"),
    HALF: np.dtype("<u2"),
    "float32": np.dtype("<f4"),
}
NAMES = {"float16": "F16", HALF: "BF16", "float32": "F32", "float64": "F64"}  # of safetensors
NO_NUMBER = 0x7F80  # bits of the exponent, all set where a bfloat16 is not finite


@dataclass(frozen=True)
class FeatureArrays:
    """Features of one clip, as :class:`encoders.FeatureMap` has them of several.

    Args:
        values: ``(t, c, h, w)``, float16 or float32; bfloat16 is read as float32.
        stride: pixels of the frames between neighbouring cells, (height, width).
        times: seconds, ``(t,)``.
    """

    values: np.ndarray
    stride: tuple[float, float]
    times: np.ndarray


@dataclass(frozen=True)
class Mapped:
    """The tensors of one entry where they lie on disk.

    Args:
        values: ``(t, c, h, w)``, of a type of :data:`KEPT`.
        dtype: what they mean.
        times: seconds, ``(t,)``.
    """

    values: np.ndarray
    dtype: str
    times: np.ndarray

    def arrays(self, stride: Sequence[float]) -> FeatureArrays:
        """For NumPy."""
        values = numbers(self.values) if self.dtype == HALF else self.values
        return FeatureArrays(values, (stride[0], stride[1]), self.times)

    def features(self, stride: Sequence[float]) -> FeatureMap:
        """For torch, memory-mapped still."""
        import torch

        from encoders.features import FeatureMap

        values = torch.from_numpy(self.values).view(getattr(torch, self.dtype))
        return FeatureMap(values[None], (stride[0], stride[1]), torch.from_numpy(self.times))


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
    values, times = (
        held[slice(*about[name]["data_offsets"])].view(kind).reshape(about[name]["shape"])
        for name, kind in (("values", KEPT[dtype]), ("times", clock))
    )
    return Mapped(values, dtype, times)


def header(times: np.ndarray, dtype: str, grid: Sequence[int]) -> bytes:
    """What safetensors writes before ``times (t,)`` and ``values (t, *grid)``."""
    shape = [len(times), *grid]
    begin, whole = times.nbytes, KEPT[dtype].itemsize * int(np.prod(shape))
    about: dict[str, Any] = {}
    for name, kind, sides, ends in (
        ("times", times.dtype.name, [len(times)], [0, begin]),
        ("values", dtype, shape, [begin, begin + whole]),
    ):
        about[name] = {"dtype": NAMES[kind], "shape": sides, "data_offsets": ends}
    text = json.dumps(about, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text


def as_times(times: Tensor | np.ndarray) -> np.ndarray:
    """Seconds, as they are kept."""
    return np.ascontiguousarray(times if isinstance(times, np.ndarray) else times.cpu().numpy())


def as_kept(piece: Tensor | np.ndarray, dtype: str) -> np.ndarray | None:
    """Values of an array or a tensor in a type of :data:`KEPT`; ``None`` where it cannot hold them.

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
