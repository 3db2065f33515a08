"""Checkpoints: tensors in safetensors, everything else in the JSON beside them.

The JSON names the tensor file and its hash and is renamed into place last, so at every instant
it points to a whole tensor file: the old one or the new one. It holds a hash of itself too. Of a
training, the checkpoint before stays as ``NAME.json.last``, for where the newest is damaged.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from encoders.tensors import read_tensors
from registry.seal import is_sealed, sealed
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256, write_json, write_tensors, write_with

SCHEMA_VERSION = 2
UNSEALED = 1  # the schema of before the JSON held a hash of itself
LAST = ".last"


class DamagedCheckpointWarning(UserWarning):
    """A training goes on from the checkpoint before the newest."""


def save(
    path: Path, tensors: dict[str, Tensor], meta: dict[str, Any], keep_last: bool = False
) -> None:
    """Write a checkpoint whose JSON is ``path`` (``.json``) and drop the one it replaces.

    Args:
        path: the JSON file; the tensors lie beside it.
        tensors: any names; made contiguous.
        meta: plain data, with at least ``step``.
        keep_last: keep the one it replaces, and drop the one before that.

    Example:
        >>> import tempfile, torch
        >>> path = Path(tempfile.mkdtemp()) / 'head.json'
        >>> save(path, {'weight': torch.ones(2)}, {'step': 10})
        >>> tensors, meta = load(path)
        >>> tensors['weight'].tolist(), meta
        ([1.0, 1.0], {'step': 10})
    """
    last = path.with_name(path.name + LAST)
    old = _named_by(path)
    name = f"{path.stem}-{meta['step']:08d}.safetensors"
    if old is not None and name == old.name:  # which must stay whole until the JSON is another
        name = name.replace(".safetensors", "-again.safetensors")
    target = path.with_name(name)
    whole = {k: v.detach().contiguous() for k, v in tensors.items()}
    write_tensors(target, whole)
    record = {
        "schema_version": SCHEMA_VERSION,
        "tensors": name,
        "sha256": sha256(target),
        "meta": meta,
    }
    if keep_last and old is not None:
        content = path.read_bytes()
        write_with(last, lambda partial: partial.write_bytes(content))
    write_json(path, sealed(record))
    if not keep_last:
        last.unlink(missing_ok=True)
    _drop_others(path, {target, _named_by(last)})


def load(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint back.

    Raises:
        InputError: missing, of another schema, or damaged (a hash does not match).
    """
    record = _read(path)
    target = path.with_name(Path(record["tensors"]).name)
    if not target.exists():
        raise InputError(f"checkpoint {path}: its tensors {target.name} are missing; delete both")
    try:
        if sha256(target) == record["sha256"]:
            return read_tensors(target), record["meta"]
    except (OSError, ValueError) as error:
        raise InputError(f"checkpoint {target}: not readable ({error}); delete both") from error
    raise InputError(
        f"checkpoint {target}: damaged (sha256 differs from {path.name}); delete both files "
        "to train again"
    )


def load_good(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Of a training: the newest checkpoint, or with a warning the one before where it is damaged.

    Raises:
        InputError: see :func:`load`; of the newest, where both are damaged.
    """
    try:
        return load(path)
    except InputError as error:
        try:
            found = load(path.with_name(path.name + LAST))
        except InputError:
            raise error from None
        text = f"{error}; going on from the one before, step {found[1].get('step')}"
        warnings.warn(text, DamagedCheckpointWarning, stacklevel=2)
        return found


def under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The tensors below ``prefix/``, without it."""
    start = f"{prefix}/"
    return {k.removeprefix(start): v for k, v in tensors.items() if k.startswith(start)}


def _named_by(path: Path) -> Path | None:
    """The tensor file of a checkpoint that can be read."""
    try:
        return path.with_name(Path(_read(path)["tensors"]).name)
    except InputError:
        return None


def _drop_others(path: Path, kept: set[Path | None]) -> None:
    """Delete the tensors of earlier saves."""
    ours = re.compile(re.escape(path.stem) + r"-\d{8,}(-again)?\.safetensors")
    for file in path.parent.iterdir():
        if ours.fullmatch(file.name) and file not in kept:
            file.unlink(missing_ok=True)


def _read(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        version, _, _, _ = (record[k] for k in ("schema_version", "tensors", "sha256", "meta"))
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"checkpoint {path}: not readable as a checkpoint ({error})") from error
    if version not in (SCHEMA_VERSION, UNSEALED):
        raise InputError(
            f"checkpoint {path}: schema version {version}, this vidphys reads {SCHEMA_VERSION}"
        )
    if not is_sealed(record, must=version == SCHEMA_VERSION):
        raise InputError(
            f"checkpoint {path}: damaged (its hash of itself differs); delete it to train again"
        )
    return record
