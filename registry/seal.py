"""Files that hold a hash of themselves, so that a changed byte is seen on reading."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np

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


def arrays_seal(arrays: Mapping[str, Any], about: Mapping[str, str]) -> str:
    """The hash of numpy's arrays and of the words beside them, but for a seal among these."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(json.dumps([name, array.dtype.str, array.shape]).encode())
        digest.update(array.tobytes())
    plain = {key: value for key, value in about.items() if key != SEAL}
    digest.update(json.dumps(plain, sort_keys=True).encode())
    return digest.hexdigest()


def are_sealed(arrays: Mapping[str, Any], about: Mapping[str, str], schema: str) -> bool:
    """Whether arrays that were read fit the seal beside them.

    Those of before there were seals have neither it nor a schema.
    """
    if SEAL not in about and "schema_version" not in about:
        return True
    return about.get("schema_version") == schema and about.get(SEAL) == arrays_seal(arrays, about)


def sealed_arrays(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Numpy's arrays with the hash of them all, 32 bytes, as one more."""
    return {**arrays, SEAL: np.frombuffer(bytes.fromhex(arrays_seal(arrays, {})), np.uint8)}


def unsealed_arrays(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """What :func:`sealed_arrays` was given.

    Raises:
        ValueError: it was not this, or an array is missing; those of schema 1 had no hash.
    """
    plain = {name: array for name, array in arrays.items() if name != SEAL}
    if SEAL not in arrays and int(arrays.get("schema_version", 1)) == 1:
        return plain
    if SEAL not in arrays or bytes(arrays[SEAL]).hex() != arrays_seal(plain, {}):
        raise ValueError("its arrays do not fit their hash")
    return plain


def _hash(data: dict[str, Any]) -> str:
    text = json.dumps(data, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
