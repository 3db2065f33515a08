"""Checkpoints: tensors in safetensors, everything else in the JSON beside them.

The JSON names the tensor file and its hash and is renamed into place last, so at every instant
it points to a whole tensor file: the old one or the new one.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors.torch import load_file, save_file
from torch import Tensor

from vidphys.errors import InputError
from vidphys.runs.atomic import sha256, write_json, write_with

SCHEMA_VERSION = 1


def save(path: Path, tensors: dict[str, Tensor], meta: dict[str, Any]) -> None:
    """Write a checkpoint whose JSON is ``path`` (``.json``) and drop the one it replaces.

    Args:
        path: the JSON file; the tensors lie beside it.
        tensors: any names; made contiguous.
        meta: plain data, with at least ``step``.

    Example:
        >>> import tempfile, torch
        >>> path = Path(tempfile.mkdtemp()) / 'head.json'
        >>> save(path, {'weight': torch.ones(2)}, {'step': 10})
        >>> tensors, meta = load(path)
        >>> tensors['weight'].tolist(), meta
        ([1.0, 1.0], {'step': 10})
    """
    old = _tensor_file(path) if path.exists() else None
    name = f"{path.stem}-{meta['step']:08d}.safetensors"
    target = path.with_name(name)
    whole = {k: v.detach().contiguous() for k, v in tensors.items()}
    write_with(target, lambda partial: save_file(whole, partial))
    record = {
        "schema_version": SCHEMA_VERSION,
        "tensors": name,
        "sha256": sha256(target),
        "meta": meta,
    }
    write_json(path, record)
    if old is not None and old != target:
        old.unlink(missing_ok=True)


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint back.

    Raises:
        InputError: missing, of another schema, or damaged (the hash does not match).
    """
    target = _tensor_file(path)
    record = json.loads(path.read_text(encoding="utf-8"))
    if not target.exists():
        raise InputError(f"checkpoint {path}: its tensors {target.name} are missing; delete both")
    if sha256(target) != record["sha256"]:
        raise InputError(
            f"checkpoint {target}: damaged (sha256 differs from {path.name}); delete both files "
            "to train again"
        )
    return load_file(target), record["meta"]


def under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors below ``prefix/``, without it."""
    start = f"{prefix}/"
    return {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}


def _tensor_file(path: Path) -> Path:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        version, name = record["schema_version"], record["tensors"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"checkpoint {path}: not readable as a checkpoint ({error})") from error
    if version != SCHEMA_VERSION:
        raise InputError(
            f"checkpoint {path}: schema version {version}, this vidphys reads {SCHEMA_VERSION}"
        )
    return path.with_name(Path(name).name)
