"""Weights of frozen encoders: where they lie, whether they are the right ones, how to get them.

Nothing is ever fetched silently. The tiny ones lie in the package. Others are looked for at the
explicit path, else in the folder ``VIDPHYS_WEIGHTS``, else in the user's cache; where they are not
there but their revision is pinned, in the hub's own cache at that revision. Their SHA-256 must be
one that the table of known weights or the lock file beside them names.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from encoders.download import Show, download
from encoders.hub import from_hub, in_cache
from encoders.known_weights import SINGLE, WeightsEntry, entry
from encoders.release import (
    CONFIG,
    INDEX,
    TENSORS,
    WeightsFile,
    WeightsMissing,
    read_config,
    release_sha256,
    shards_of,
)

FOLDER_VARIABLE = "VIDPHYS_WEIGHTS"
PACKAGED = Path(__file__).parent / "data"


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
        name: see :func:`encoders.known_weights.entry`.
        where: a weights folder, or the file or release folder itself; see :func:`weights_folder`
            for the default.

    Raises:
        WeightsMissing: they are not there, or not whole.
        ValueError: unknown name, or another hash than the known or locked ones.
    """
    known = entry(name)
    place = weights_path(name, where)
    locked = _locked(place)
    path = place if place.exists() else _cached(known, known.revision or locked["revision"])
    if path is None or path.is_dir() != known.is_folder:
        copied = (
            f", or copy {known.what_to_copy()} to {place} and let `vidphys weights check {name}` "
            "lock its hash"
        )
        raise WeightsMissing(
            f"weights of {name!r}: no {'folder' if known.is_folder else 'file'} {place}; get it by "
            f"{known.how_to_get(name)}{copied if known.hub or known.url else ''}, or give its "
            f"folder as `weights` or in {FOLDER_VARIABLE}"
        )
    digest = release_sha256(path)
    accepted = [sha256 for sha256 in (*known.sha256, locked["sha256"]) if sha256]
    if digest not in accepted:
        raise ValueError(
            f"weights of {name!r}: {path} has sha256 {digest}, expected "
            f"{' or '.join(accepted) or 'one that was locked'}; it is damaged or another release: "
            f"fetch it again, or accept it by `vidphys weights check {name}` with `lock`"
        )
    return WeightsFile(path, digest)


def config_of(
    name: str, where: Path | None, expected: dict[str, Any], usual: dict[str, Any]
) -> dict[str, Any]:
    """How the network ``name`` is built, whether or not its weights are here.

    Args:
        name, where: see :func:`find_weights`.
        expected: see :func:`encoders.release.read_config`.
        usual: of the release, where its ``config.json`` is not on this machine.
    """
    folder = weights_path(name, where)
    return read_config(folder, expected) if (folder / CONFIG).is_file() else expected | usual


def weights_path(name: str, where: Path | None = None) -> Path:
    """Where the weights ``name`` should lie; see :func:`find_weights`.

    Those of the package are elsewhere only where ``where`` is itself a release folder.
    """
    if where is not None and (where.suffix in SINGLE or (where / CONFIG).is_file()):
        return where
    known = entry(name)
    return (PACKAGED if known.packaged else weights_folder(where)) / known.file


def lock(path: Path, revision: str | None) -> str:
    """Accept weights as they are: write their hash into the lock file beside; return the hash."""
    digest = release_sha256(path)
    record = {"schema_version": 1, "sha256": digest, "revision": revision}
    _replace(_lock_path(path), json.dumps(record, indent=2).encode())
    return digest


def fetch(name: str, folder: Path | None = None, show: Show | None = None) -> WeightsFile:
    """Download the weights ``name``, from the hub at the pinned (or then locked) revision.

    What broke off is gone on with; what is here already, or comes with the package, is not fetched.

    Args:
        name: see :func:`encoders.known_weights.entry`.
        folder: see :func:`weights_folder`.
        show: of a file that no hub has, called as ``(bytes there, bytes in all)``; the hub's own
            client shows its progress itself.

    Raises:
        ValueError: unknown name, weights that no hub has, or others than those that are pinned, of
            which nothing is kept.
        ConnectionError: they could not be had from there.
    """
    known = entry(name)
    if known.packaged:
        return find_weights(name)
    target = weights_folder(folder) / known.file
    if known.url is None and known.hub is None:
        raise ValueError(
            f"weights of {name!r}: no hub has them; get {known.file} elsewhere and put it at "
            f"{target}"
        )
    with suppress(ValueError):  # not here, or not whole
        return find_weights(name, folder)
    locked = _locked(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    if known.url is not None:
        got = download(known.url, target.with_name(f".{target.name}.new"), show)
        try:
            digest = release_sha256(got)
            _require_accepted(name, digest, known.sha256 or (locked["sha256"],), known.begins)
            _move(got, target)
        finally:
            got.unlink(missing_ok=True)
        lock(target, None)
        return find_weights(name, folder)
    with tempfile.TemporaryDirectory(dir=target.parent) as scratch:
        got = Path(scratch) / known.file
        try:
            revision = _download(known, known.revision or locked["revision"], got)
        except FileNotFoundError as error:
            raise ConnectionError(str(error)) from error
        _require_accepted(name, release_sha256(got), known.sha256 or (locked["sha256"],))
        _move(got, target)
    lock(target, revision)
    return find_weights(name, folder)


def _require_accepted(
    name: str, digest: str, known: Sequence[str | None], begins: str = ""
) -> None:
    """Refuse what came where another file is known; nothing of it is kept."""
    accepted = [sha256 for sha256 in known if sha256]
    if (accepted and digest not in accepted) or not digest.startswith(begins):
        expected = " or ".join(accepted) or f"one that begins with {begins}"
        raise ValueError(
            f"weights of {name!r}: what came has sha256 {digest}, expected {expected}; nothing was "
            "kept: it is another release, or was changed on its way"
        )


def _download(known: WeightsEntry, revision: str | None, got: Path) -> str | None:
    """Put a release of the hub there; returns the commit that it is of."""
    assert known.hub is not None
    if not known.is_folder:
        source, commit = from_hub(known.hub, TENSORS, revision)
        shutil.copyfile(source, got)
        return commit
    got.mkdir()
    source, commit = from_hub(known.hub, CONFIG, revision)
    shutil.copyfile(source, got / CONFIG)
    names = [TENSORS]
    try:
        source, _ = from_hub(known.hub, TENSORS, commit)
    except FileNotFoundError:
        source, _ = from_hub(known.hub, INDEX, commit)
        names = [INDEX, *shards_of(source)]
    for name in names:
        source, _ = from_hub(known.hub, name, commit)
        shutil.copyfile(source, got / name)
    for name in known.beside:
        with suppress(FileNotFoundError):
            source, _ = from_hub(known.hub, name, commit)
            shutil.copyfile(source, got / name)
    return commit


def _move(got: Path, target: Path) -> None:
    """A file, or the files of a folder, to where they belong; what else is there stays."""
    if got.is_file():
        got.replace(target)
        return
    target.mkdir(exist_ok=True)
    for file in got.iterdir():
        file.replace(target / file.name)


def _cached(known: WeightsEntry, revision: str | None) -> Path | None:
    """The weights in the hub's own cache at a pinned revision."""
    if known.hub is None or revision is None:
        return None
    if known.is_folder:
        return in_cache(known.hub, CONFIG, revision=revision)
    folder = in_cache(known.hub, TENSORS, revision=revision)
    return None if folder is None else folder / TENSORS


def _lock_path(path: Path) -> Path:
    return path.with_suffix(".lock.json")


def _locked(path: Path) -> dict[str, Any]:
    record: dict[str, Any] = {"sha256": None, "revision": None}
    if _lock_path(path).is_file():
        held = _lock_path(path)
        try:
            record |= {key: json.loads(held.read_text(encoding="utf-8"))[key] for key in record}
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise ValueError(f"weights: {held} is not a lock ({error}); delete it") from error
    return record


def _replace(path: Path, data: bytes) -> None:
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    partial.write_bytes(data)
    partial.replace(path)
