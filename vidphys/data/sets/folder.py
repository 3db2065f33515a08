"""A folder of clips: video files with tables beside them, or what its manifest lists.

A folder may hold ``dataset.json``, which a rendered one always does and a user may write:
``half_extent`` (units of the labels' x and y in half of the longer image side), ``identical``
(bodies that look alike), ``conserving`` (no friction in it) and ``clips``, a list of ``file`` with
the ``coupling``, the ``mass`` of each body, the ``split`` and further ``facts`` of each. Without it
a folder's clips are its video files, labels are in normalised image units, and coupling and masses
are one.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, JsonValue

from vidphys.boundary import Above, Closed, Number, Sha256, Word, is_below, read_json
from vidphys.data.beside import Beside
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.formats import ClipFormat, format_of, suffixes_of
from vidphys.data.labels import Labels
from vidphys.errors import InputError, is_utf8
from vidphys.runs.atomic import sha256

MANIFEST = "dataset.json"
SCHEMA_VERSION = 1


def _plain(file: str) -> str:
    """A name below the folder, on whatever system."""
    if "\0" in file or not is_utf8(file) or not file.strip():
        raise ValueError(f"clips: {file!a} is no name of a file")
    for path in (PurePosixPath(file), PureWindowsPath(file)):
        if path.is_absolute() or path.drive or path.root or ".." in path.parts:
            raise ValueError(f"clips: {file!a}, which is not in its folder; name files below it")
    return file


File = Annotated[str, Field(max_length=1000), AfterValidator(_plain)]


class Listed(Closed):
    """A clip in a manifest; see the module."""

    file: File
    sha256: Sha256 | None = None
    labels_sha256: Sha256 | None = None
    truth: File | None = None
    coupling: Number = 1.0
    mass: Annotated[tuple[Above, ...], Field(min_length=1, max_length=1000)] | None = None
    split: Word | None = None
    facts: Annotated[dict[str, str | Number], Field(max_length=1000)] = {}


class Manifest(Closed):
    """What ``dataset.json`` holds; see the module. What was rendered says how."""

    schema_version: Literal[1] = 1
    clips: Annotated[tuple[Listed, ...], Field(max_length=100_000)]
    half_extent: Above = 1.0
    identical: bool = False
    conserving: bool = False
    scene: Word | None = None
    settings: dict[str, JsonValue] = {}
    world: Word | None = None
    interval_seconds: Above | None = None
    derivatives_without: Word | None = None


def read_folder(path: Path) -> Dataset:
    """The clips of a folder.

    Raises:
        InputError: no clips, a rendering that is not finished, a manifest that is wrong, or labels
            beside some of the clips only.
    """
    manifest, beside = path / MANIFEST, Beside()
    if manifest.is_file():
        about = read_manifest(manifest, beside)
        files = [_listed(path, entry, beside) for entry in about.clips]
    else:
        about = None
        videos = (p for p in path.iterdir() if format_of(p, ClipFormat) is not None)
        files = [ClipFile(p, _labels(beside.labels(p))) for p in sorted(videos)]
    if not files:
        unfinished = (path / "clips").is_dir()
        hint = "; its rendering is not finished: run that command again" if unfinished else ""
        raise InputError(
            f"{path}: no clips ({', '.join(suffixes_of(ClipFormat))}) in this folder{hint}"
        )
    return Dataset(tuple(files), **_facts(about))


def read_file(path: Path) -> Dataset:
    """One clip, with what lies beside it and what the manifest of its folder tells.

    Raises:
        InputError: a manifest that is wrong.
    """
    found, beside = _manifest_of(path), Beside()
    if found is None:
        return Dataset((ClipFile(path, _labels(beside.labels(path))),))
    folder, about = found
    for entry in about.clips:
        if (folder / entry.file).resolve() == path.resolve():
            return Dataset((_listed(folder, entry, beside),), **_facts(about))
    return Dataset((ClipFile(path, _labels(beside.labels(path))),), **_facts(about))


def read_manifest(path: Path, beside: Beside | None = None) -> Manifest:
    """The content of a ``dataset.json``.

    Raises:
        InputError: not such a manifest, or one that lists files that are not there or not in its
            folder.
    """
    about, beside = read_json(path, Manifest, "a manifest of clips"), beside or Beside()
    missing = [e.file for e in about.clips if not (path.parent / e.file).is_file()]
    if missing:
        raise InputError(f"{path}: lists {missing[0]}, which is not there; {len(missing)} missing")
    for entry in about.clips:
        listed = path.parent / entry.file
        for file in (listed, beside.labels(listed)):
            if file is not None and not is_below(file, path.parent):
                raise InputError(
                    f"{path}: lists {entry.file}, which is not in its folder; move it there"
                )
    return about


def _manifest_of(clip: Path) -> tuple[Path, Manifest] | None:
    """The manifest of the folder that a clip lies in, or of the one above, with that folder."""
    for folder in (clip.resolve().parent, clip.resolve().parent.parent):
        if (folder / MANIFEST).is_file():
            return folder, read_manifest(folder / MANIFEST)
    return None


def _listed(folder: Path, entry: Listed, beside: Beside) -> ClipFile:
    path = folder / entry.file
    labels = beside.labels(path)
    for file, held in ((path, entry.sha256), (labels, entry.labels_sha256)):
        if file is not None and held is not None and sha256(file) != held:
            raise InputError(
                f"{file}: not the file that {folder / MANIFEST} lists (its sha256 differs); make "
                "it again, or take its hash out of the list where it was changed on purpose"
            )
    truth = _labels(None if entry.truth is None else folder / entry.truth)
    law = entry.coupling, entry.mass
    return ClipFile(path, _labels(labels), *law, truth, entry.facts, entry.split or "")


def _labels(path: Path | None) -> Labels | None:
    return None if path is None else Labels.of(path)


def _facts(about: Manifest | None) -> dict[str, Any]:
    if about is None:
        return {}
    return {key: getattr(about, key) for key in ("half_extent", "identical", "conserving")}
