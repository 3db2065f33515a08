"""Weights on disk as they are released: which files, their hash, their tensors, strictly.

A release is one safetensors file, or a folder as the hub's libraries write it: ``config.json``
beside ``model.safetensors``, or beside ``model.safetensors.index.json`` and the shards it names.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from encoders.tensors import read_tensors

if TYPE_CHECKING:
    from torch import Tensor, nn

CONFIG = "config.json"
TENSORS = "model.safetensors"
INDEX = "model.safetensors.index.json"
SHARD = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*\.safetensors")
MOST_JSON = 2**26  # bytes


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
        names = [CONFIG, INDEX, *shards_of(path / INDEX)]
    for name in names:
        if not (path / name).is_file():
            raise WeightsMissing(
                f"weights: {path} has no {name}; a release folder holds {CONFIG} and {TENSORS} "
                f"(or {INDEX} and its shards), other formats are not read"
            )
    return [path / name for name in names]


def shards_of(index: Path) -> list[str]:
    """The files that an index of tensors names, each plainly in its own folder.

    Raises:
        ValueError: not an index, or one that leads out of the folder.
    """
    try:
        if index.stat().st_size > MOST_JSON:
            raise ValueError(f"more than {MOST_JSON >> 20} MiB")
        held = json.loads(index.read_text(encoding="utf-8"))
        shards = sorted(set(held["weight_map"].values()))
        odd = next((shard for shard in shards if not SHARD.fullmatch(shard)), None)
        if odd is not None:
            raise ValueError(f"it names {odd!a:.80}, which is no safetensors file beside it")
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"weights: {index} is not an index of shards ({error})") from error
    return shards


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
    tensors: dict[str, Tensor] = {}
    for file in release_files(path):
        if file.suffix == ".safetensors":
            tensors |= read_tensors(file)
    return tensors


def read_config(folder: Path, expected: dict[str, Any]) -> dict[str, Any]:
    """The ``config.json`` of a release folder.

    Args:
        folder: of the release.
        expected: keys whose values tell that it is the right kind of model.

    Raises:
        ValueError: not JSON, or another kind of model.
    """
    path = folder / CONFIG
    try:
        config = dict(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError, RecursionError) as error:
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
