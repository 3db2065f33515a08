"""Arrays of files of somebody else's format, which a child process reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.data.formats import bounded
from vidphys.data.formats.bounded import require_room
from vidphys.data.formats.child import Child
from vidphys.errors import InputError

MEMORY = 3 * 2**29  # bytes that reading may ask for
SECONDS = 60  # of processor time
KINDS = "fiubmMU"  # of numbers, times and words


def read_apart(path: Path, kind: str, packages: Sequence[str]) -> dict[str, np.ndarray]:
    """The arrays of a file by their names, in its order.

    Args:
        path: of the file.
        kind: of it: ``c3d``, ``matlab``, ``matlab 7.3``, ``parquet``, ``tracks`` or ``workbook``.
        packages: that read it.

    Raises:
        InputError: it cannot be read, is too large, or reading takes more than it may.
    """
    limits = (kind, MEMORY, SECONDS, bounded.MOST_BYTES, bounded.MOST_COLUMNS)
    with Child(path, "table.py", limits, packages, "save it as CSV or NPZ") as child:
        return received(child, child.message())


def received(child: Child, message: dict[str, Any], before: int = 0) -> dict[str, np.ndarray]:
    """The arrays that a message of a child tells of.

    Args:
        child: whose message it is.
        message: names, types and shapes, under ``arrays``.
        before: bytes that were received of the same file.

    Raises:
        InputError: they are too large, or no numbers, times or words.
    """
    told = [(name, np.dtype(kind), shape) for name, kind, shape in message["arrays"]]
    for name, dtype, shape in told:
        require_room(shape, dtype.itemsize, name)
        if dtype.kind not in KINDS:
            raise InputError(f"{name} holds {dtype}, which are no numbers")
    size = sum(int(np.prod(shape)) * dtype.itemsize for _, dtype, shape in told)
    require_room((before + size,), 1, "all of it")
    held = {}
    for name, dtype, shape in told:
        held[name] = np.empty(shape, dtype)
        if held[name].size:
            child.fill(held[name].reshape(-1).view(np.uint8).data)
    return held
