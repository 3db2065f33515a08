"""Weights on disk as they are released: which files, their hash, their tensors, strictly.

A release is one safetensors file, or a folder as the hub's libraries write it: ``config.json``
beside ``model.safetensors``, or beside ``model.safetensors.index.json`` and the shards it names.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor, nn

CONFIG = "config.json"
TENSORS = "model.safetensors"
INDEX = "model.safetensors.index.json"


class WeightsMissing(ValueError):
    """The weights are not on this machine; the message names the command that gets them."""


@dataclass(frozen=True)
class WeightsFile:
    """Weights that were found and checked: a file or a release folder, and its hash."""

    path: Path
    sha256: str


def release_files(path: Path) -> list[Path]:
    """The files that weights consist of: the file itself, or those of a release folder.

    Raises:
        WeightsMissing: the folder is not whole, or has no safetensors.
    """
    if path.is_file():
        return [path]
    names = [CONFIG, TENSORS]
    if not (path / TENSORS).is_file() and (path / INDEX).is_file():
        index = json.loads((path / INDEX).read_text(encoding="utf-8"))
        names = [CONFIG, INDEX, *sorted(set(index["weight_map"].values()))]
    for name in names:
        if not (path / name).is_file():
            raise WeightsMissing(
                f"weights: {path} has no {name}; a release folder holds {CONFIG} and {TENSORS} "
                f"(or {INDEX} and its shards), other formats are not read"
            )
    return [path / name for name in names]


def release_sha256(path: Path) -> str:
    """Hash of a file's bytes; of a release folder, of its files' names and hashes."""
    if path.is_file():
        return file_sha256(path)
    lines = [f"{file_sha256(file)}  {file.name}\n" for file in release_files(path)]
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def load_strict(
    module: nn.Module,
    path: Path,
    unused: Iterable[str] = (),
    rename: Callable[[str], str] | None = None,
) -> None:
    """Copy weights into ``module``, every key of one being in the other.

    Args:
        module: keeps its dtype and device.
        path: a safetensors file, or a release folder.
        unused: prefixes of (renamed) keys that may be absent, or present and ignored (a head).
        rename: from a key of the release to the module's.

    Raises:
        ValueError: not a safetensors file, missing or unknown keys, or another shape.
    """
    renamed = {rename(k) if rename else k: v for k, v in _tensors(path).items()}
    load_tensors(module, path, renamed, unused)


def load_tensors(
    module: nn.Module, path: Path, tensors: Mapping[str, Tensor], unused: Iterable[str] = ()
) -> None:
    """As :func:`load_strict`, of tensors that were read from ``path``."""
    prefixes = tuple(unused)
    wanted = module.state_dict()
    used = {k: v for k, v in tensors.items() if not k.startswith(prefixes)}
    _same_keys(path, wanted, used, prefixes)
    module.load_state_dict({**wanted, **used})


def _tensors(path: Path) -> dict[str, Tensor]:
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    tensors: dict[str, Tensor] = {}
    for file in release_files(path):
        if file.suffix == ".safetensors":
            try:
                tensors |= load_file(file)
            except SafetensorError as error:
                raise ValueError(f"weights: {file} is not a safetensors file ({error})") from error
    return tensors


def read_config(weights: WeightsFile, expected: dict[str, Any]) -> dict[str, Any]:
    """The ``config.json`` of a release folder.

    Args:
        weights: the folder.
        expected: keys whose values tell that it is the right kind of model.

    Raises:
        ValueError: not JSON, or another kind of model.
    """
    path = weights.path / CONFIG
    try:
        config = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"weights: {path} is not JSON ({error}); fetch it again") from error
    for key, value in expected.items():
        if config.get(key) != value:
            raise ValueError(
                f"weights: {path} has {key} {config.get(key)!r}, expected {value!r}; it is another "
                "model"
            )
    return config


def _same_keys(
    path: Path, wanted: dict[str, Tensor], got: dict[str, Tensor], unused: tuple[str, ...]
) -> None:
    missing = [k for k in wanted if k not in got and not k.startswith(unused)]
    unknown = [k for k in got if k not in wanted]
    if missing or unknown:
        raise ValueError(
            f"weights: {path} does not fit: {len(missing)} keys missing {missing[:3]}, "
            f"{len(unknown)} unknown {unknown[:3]}; is it another model or layout?"
        )
    for key, value in got.items():
        if value.shape != wanted[key].shape:
            raise ValueError(
                f"weights: {path}: {key} has shape {tuple(value.shape)}, expected "
                f"{tuple(wanted[key].shape)}; it is another model"
            )


def file_sha256(path: Path) -> str:
    """Hex digest of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
