"""Arrays of Parquet and MATLAB files, which a child process reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
        kind: of it: ``parquet`` or ``matlab``.
        packages: that read it.

    Raises:
        InputError: it cannot be read, is too large, or reading takes more than it may.
    """
    limits = (kind, MEMORY, SECONDS, bounded.MOST_BYTES, bounded.MOST_COLUMNS)
    with Child(path, "table.py", limits, packages, "save it as CSV or NPZ") as child:
        told = [(name, np.dtype(kind), shape) for name, kind, shape in child.message()["arrays"]]
        for name, dtype, shape in told:
            require_room(shape, dtype.itemsize, name)
            if dtype.kind not in KINDS:
                raise InputError(f"{name} holds {dtype}, which are no numbers")
        require_room(
            (sum(int(np.prod(shape)) * d.itemsize for _, d, shape in told),), 1, "all of it"
        )
        held = {}
        for name, dtype, shape in told:
            held[name] = np.empty(shape, dtype)
            if held[name].size:
                child.fill(held[name].reshape(-1).view(np.uint8).data)
    return held
