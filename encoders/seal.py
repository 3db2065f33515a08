"""A JSON file that holds a hash of itself, so that a changed byte is seen on reading."""

from __future__ import annotations

import hashlib
import json
from typing import Any

SEAL = "seal"


def sealed(data: dict[str, Any]) -> dict[str, Any]:
    """``data`` with the hash of its content as ``seal``."""
    plain = json.loads(json.dumps(data, allow_nan=False))
    return {**plain, SEAL: _hash(plain)}


def is_sealed(data: dict[str, Any], must: bool) -> bool:
    """Whether data that was read fits its seal.

    Args:
        data: what was read.
        must: whether it has to hold one; what was written before there were seals need not.
    """
    if SEAL not in data:
        return not must
    return data[SEAL] == _hash({key: value for key, value in data.items() if key != SEAL})


def _hash(data: dict[str, Any]) -> str:
    text = json.dumps(data, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
