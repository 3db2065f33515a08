"""Room for a tensor: in memory, or in a file that the system may write out where it is large."""

from __future__ import annotations

import math
import mmap
import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile

import torch
from torch import Tensor

HELD = 2**28  # bytes that are kept in memory


def room(shape: Sequence[int], dtype: torch.dtype, folder: Path | None = None) -> Tensor:
    """An unfilled tensor; one of more than :data:`HELD` bytes lies in a nameless file.

    The file is gone with the tensor, and with the process, however that ends.

    Args:
        shape: of the tensor.
        dtype: of its values.
        folder: where the file lies; ``None`` keeps everything in memory.

    Raises:
        OSError: the disk has no room.
    """
    size = math.prod(shape) * dtype.itemsize
    if folder is None or size <= HELD:
        return torch.empty(tuple(shape), dtype=dtype)
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryFile(dir=folder) as file:
        if hasattr(os, "posix_fallocate"):  # else a disk that fills up later ends the process
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
        return torch.frombuffer(mmap.mmap(file.fileno(), size), dtype=dtype).view(tuple(shape))
