"""Weights of frozen encoders: where they lie, whether they are the right ones, how to load them.

Nothing is ever fetched silently. A file is looked for at the explicit path, else in the folder
``VIDPHYS_WEIGHTS``, else in the user's cache; its SHA-256 must be one that the table below or the
lock file beside it names.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor, nn

FOLDER_VARIABLE = "VIDPHYS_WEIGHTS"


@dataclass(frozen=True)
class WeightsEntry:
    """A public set of weights.

    Args:
        file: name in the weights folder.
        sha256: the hashes of known files; others are accepted once locked.
        licence: SPDX name.
        hub: repository on the Hugging Face hub, and the file in it.
        revision: commit of the hub repository; ``None`` is resolved and locked by the first fetch.
        about: one line for people.
    """

    file: str
    sha256: tuple[str, ...]
    licence: str
    hub: tuple[str, str]
    revision: str | None
    about: str


KNOWN = {
    "hiera": WeightsEntry(
        file="sam2_hiera_tiny.safetensors",
        sha256=("1783be247fa6b056d3dbaba07bcbf3dbe1652533d15cddf5749d5ee553dc2a75",),
        licence="Apache-2.0",
        hub=("timm/sam2_hiera_tiny.fb_r896", "model.safetensors"),
        revision=None,
        about="SAM 2 image trunk, Hiera-Tiny, 26.85 M parameters (arXiv:2408.00714)",
    ),
}


class WeightsMissing(ValueError):
    """The weights are not on this machine; the message names the command that gets them."""


@dataclass(frozen=True)
class WeightsFile:
    """A file that was found and checked."""

    path: Path
    sha256: str


def entry(name: str) -> WeightsEntry:
    """The table's entry.

    Raises:
        ValueError: unknown name.
    """
    if name not in KNOWN:
        raise ValueError(f"weights: unknown name {name!r}; known are {', '.join(KNOWN)}")
    return KNOWN[name]


def weights_folder(folder: Path | None = None) -> Path:
    """The given folder, else ``VIDPHYS_WEIGHTS``, else the user's cache."""
    if folder is not None:
        return folder
    if FOLDER_VARIABLE in os.environ:
        return Path(os.environ[FOLDER_VARIABLE])
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache) / "vidphys" / "weights"


def find_weights(name: str, where: Path | None = None) -> WeightsFile:
    """Find and check the weights ``name``.

    Args:
        name: a key of ``KNOWN``.
        where: a folder, or the file itself; see :func:`weights_folder` for the default.

    Raises:
        WeightsMissing: there is no such file.
        ValueError: unknown name, or a file with another hash than the known or locked ones.
    """
    known = entry(name)
    path = _path(known, where)
    if not path.is_file():
        raise WeightsMissing(
            f"weights of {name!r}: no file {path}; get it with `vidphys weights fetch {name}`, or "
            f"name its folder with --weights DIR or {FOLDER_VARIABLE}"
        )
    digest = file_sha256(path)
    locked = _locked(path).get("sha256")
    accepted = (*known.sha256, locked) if locked else known.sha256
    if digest not in accepted:
        raise ValueError(
            f"weights of {name!r}: {path} has sha256 {digest}, expected {' or '.join(accepted)}; "
            f"it is damaged or another release: fetch it again, or accept it with "
            f"`vidphys weights check --lock`"
        )
    return WeightsFile(path, digest)


def lock(path: Path, revision: str | None) -> str:
    """Accept a file as it is: write its hash into the lock file beside it; return the hash."""
    digest = file_sha256(path)
    record = {"schema_version": 1, "sha256": digest, "revision": revision}
    _replace(_lock_path(path), json.dumps(record, indent=2).encode())
    return digest


def fetch(name: str, folder: Path | None = None) -> WeightsFile:
    """Download the weights ``name`` from the hub at the pinned (or then locked) revision.

    Raises:
        ValueError: unknown name.
        ConnectionError: the hub did not give the file.
    """
    known = entry(name)
    repository, file = known.hub
    target = weights_folder(folder) / known.file
    revision = known.revision or _locked(target).get("revision")
    source, revision = _from_hub(repository, file, revision)
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        shutil.copyfile(source, Path(scratch) / "weights")
        (Path(scratch) / "weights").replace(target)
    lock(target, revision)
    return find_weights(name, target)


def _from_hub(repository: str, file: str, revision: str | None) -> tuple[Path, str]:
    """The file in the hub's own cache, and the commit it is of."""
    from huggingface_hub import HfApi, hf_hub_download

    # the client raises errors of several libraries; all mean that there is no file
    try:
        commit = revision or HfApi().model_info(repository).sha
        return Path(hf_hub_download(repository, file, revision=commit)), str(commit)
    except Exception as error:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise ConnectionError(f"{repository}/{file}: {reason}") from error


def load_strict(module: nn.Module, path: Path, unused: Iterable[str] = ()) -> None:
    """Copy a safetensors file into ``module``, every key of one being in the other.

    Args:
        module: keeps its dtype and device.
        path: the file.
        unused: prefixes of keys that may be absent, or present and ignored (a classifier head).

    Raises:
        ValueError: not a safetensors file, missing or unknown keys, or another shape.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    prefixes = tuple(unused)
    try:
        tensors = load_file(path)
    except SafetensorError as error:
        raise ValueError(f"weights: {path} is not a safetensors file ({error})") from error
    wanted = module.state_dict()
    used = {k: v for k, v in tensors.items() if not k.startswith(prefixes)}
    _same_keys(path, wanted, used, prefixes)
    module.load_state_dict({**wanted, **used})


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


def _path(known: WeightsEntry, where: Path | None) -> Path:
    if where is not None and where.suffix == ".safetensors":
        return where
    return weights_folder(where) / known.file


def _lock_path(path: Path) -> Path:
    return path.with_suffix(".lock.json")


def _locked(path: Path) -> dict[str, Any]:
    if not _lock_path(path).is_file():
        return {}
    return json.loads(_lock_path(path).read_text(encoding="utf-8"))


def _replace(path: Path, data: bytes) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    partial.write_bytes(data)
    partial.replace(path)
