"""What a run folder keeps, read as it was written or not at all."""

from __future__ import annotations

import json
import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from registry.seal import SEAL, is_sealed, unsealed_arrays
from registry.tables import read_hashed

READ = 2  # the newest schema
UNSEALED = 1  # the last schema of most files that held no hash of themselves


def rows(path: Path) -> list[dict[str, Any]]:
    """The rows of a table.

    Raises:
        ValueError: it is missing, damaged, or a newer vidphys wrote it.
    """
    return read_hashed(path).to_pylist()


def arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz``, all of which are there.

    Raises:
        ValueError: it is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return unsealed_arrays(dict(file))
    except (OSError, ValueError, EOFError, KeyError, RuntimeError, zlib.error, BadZipFile) as error:
        raise ValueError(f"{path}: damaged ({error}); run again") from error


def words(path: Path, unsealed: int = UNSEALED) -> dict[str, Any]:
    """What a JSON file holds, without its seal.

    Args:
        path: the file.
        unsealed: the last schema of such a file that had no seal, 0 where all have one.

    Raises:
        ValueError: it is missing, cannot be read, damaged, or a newer vidphys wrote it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        version = data.get("schema_version", unsealed)
        good = version > READ or is_sealed(data, must=version > unsealed)
    except (OSError, ValueError, AttributeError, TypeError, RecursionError) as error:
        raise ValueError(f"{path}: cannot be read ({error}); run again") from error
    if version > READ:
        raise ValueError(f"{path}: schema version {version}, this reads {READ}")
    if not good:
        raise ValueError(f"{path}: damaged or edited (it does not fit its hash); run again")
    return {key: value for key, value in data.items() if key != SEAL}
