"""JSON files of ours that are read back: each says its schema and holds a hash of itself."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from registry.seal import SEAL, is_sealed, sealed
from vidphys.errors import InputError
from vidphys.runs.atomic import write_json


def write_sealed(path: Path, data: dict[str, Any], schema: int) -> None:
    """Write ``data`` with its schema and its hash; NaN and infinity are refused."""
    write_json(path, sealed({"schema_version": schema, **data}))


def read_sealed(
    path: Path, what: str, todo: str, schema: int, keys: Sequence[str] = (), unsealed: int = 0
) -> dict[str, Any]:
    """Read such a file back, without its seal.

    Args:
        path: the file.
        what: it holds, for messages.
        todo: what the reader of a message is to do about a damaged one.
        schema: that is read.
        keys: that must be there.
        unsealed: the last schema of before there were seals, which is read too; of those before
            a file said its schema, 0.

    Raises:
        InputError: it cannot be read, is of another schema, or damaged.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        version, missing = data.get("schema_version", 0), [key for key in keys if key not in data]
        if missing and version in (0, schema, unsealed):
            raise ValueError(f"it has no {', '.join(missing)}")
    except (OSError, ValueError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: not readable as {what} ({error}); {todo}") from error
    if version not in (schema, unsealed):
        raise InputError(f"{path}: schema version {version}, this vidphys reads {schema}")
    if not is_sealed(data, must=version == schema):
        raise InputError(f"{path}: damaged or edited (it does not fit its hash); {todo}")
    return {key: value for key, value in data.items() if key != SEAL}
