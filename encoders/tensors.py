"""Tensors of a safetensors file, whose header is held to limits before anything is made of it."""

from __future__ import annotations

import json
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

MOST_HEADER = 100_000_000  # bytes
MOST_TENSORS = 10_000
BYTES = {
    **dict.fromkeys(("BOOL", "U8", "I8"), 1),
    **dict.fromkeys(("F16", "BF16", "I16"), 2),
    **dict.fromkeys(("F32", "I32"), 4),
    **dict.fromkeys(("F64", "I64"), 8),
}


def read_tensors(path: Path) -> dict[str, Tensor]:
    """All tensors of a file, by name.

    Raises:
        ValueError: not such a file, or one with more tensors, other types or other sizes than its
            bytes can hold.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    _require_sound(path)
    try:
        return load_file(path)
    except (SafetensorError, OSError, ValueError) as error:
        raise ValueError(f"weights: {path} is not a safetensors file ({error})") from error


def _require_sound(path: Path) -> None:
    size = path.stat().st_size
    with path.open("rb") as file:
        count = int.from_bytes(file.read(8), "little")
        if not 2 <= count <= min(MOST_HEADER, size - 8):
            raise ValueError(f"weights: {path} is not a safetensors file (a header of {count} B)")
        header = file.read(count)
    if header.count(b'"dtype"') > MOST_TENSORS:  # before each becomes an object
        raise ValueError(f"weights: {path} has more than {MOST_TENSORS} tensors")
    try:
        held = json.loads(header)
        about = {name: entry for name, entry in held.items() if name != "__metadata__"}
        for name, entry in about.items():
            first, last = entry["data_offsets"]
            if entry["dtype"] not in BYTES:
                raise ValueError(f"{name!a:.80} is of {entry['dtype']!a:.20}")
            shape = [int(side) for side in entry["shape"]]
            whole = BYTES[entry["dtype"]] * prod(shape)
            if min(shape, default=0) < 0 or last - first != whole or last > size - 8 - count:
                raise ValueError(f"{name!a:.80} of {shape[:8]} is not of {last - first} B")
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        said = " ".join(str(error).split())[:200]
        raise ValueError(f"weights: {path} is not a safetensors file ({said})") from error
