"""What a training is given: one clip, a folder of the user's clips, or a rendered folder.

A folder may hold ``dataset.json``, which a rendered one always does and a user may write:
``half_extent`` (units of the labels' x and y in half of the longer image side), ``identical``
(bodies that look alike), ``conserving`` (no friction in it) and ``clips``, a list of ``file`` with
the ``coupling`` and the ``mass`` of each body. Without it a folder's clips are its video files,
labels are in normalised image units, and coupling and masses are one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Annotated, Any, Literal

import torch
from pydantic import AfterValidator, Field, JsonValue

from dynamics import Parameters
from vidphys.boundary import Above, Closed, Number, Sha256, Word, read_json
from vidphys.data.formats import ClipFormat, format_of, suffixes_of
from vidphys.data.labels import labels_beside
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


@dataclass(frozen=True)
class ClipFile:
    """One clip on disk.

    Args:
        path: the video.
        labels: the table beside it, if there is one.
        truth: the table of all that is known of it, if there is one.
        coupling: G of the law that held.
        mass: of each body; ones where nothing is said.
    """

    path: Path
    labels: Path | None
    coupling: float = 1.0
    mass: tuple[float, ...] | None = None
    truth: Path | None = None

    def law(self, bodies: int) -> Parameters:
        """What a head is told of the clip, batch of one.

        Raises:
            InputError: masses of another number of bodies.
        """
        mass = (1.0,) * bodies if self.mass is None else self.mass
        if len(mass) != bodies:
            raise InputError(f"{self.path}: {bodies} bodies, but {MANIFEST} has {len(mass)} masses")
        return Parameters(torch.tensor([self.coupling]), torch.tensor([mass]))


@dataclass(frozen=True)
class Dataset:
    """Clips that belong together.

    Args:
        files: in the order of their names, at least one.
        half_extent: units of the labels, see the module.
        identical, conserving: see the module.
    """

    files: tuple[ClipFile, ...]
    half_extent: float = 1.0
    identical: bool = False
    conserving: bool = False

    @property
    def labelled(self) -> bool:
        """Whether tables tell the positions; else they are followed by what moves."""
        return self.files[0].labels is not None

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of every file."""
        return {path.name: sha256(path) for path in self.paths}

    @property
    def paths(self) -> list[Path]:
        """Of the clips and their labels."""
        return [p for f in self.files for p in (f.path, f.labels) if p is not None]


def find_dataset(path: Path) -> Dataset:
    """The clips that ``path`` names.

    Raises:
        InputError: nothing there, a folder without clips or of a rendering that is not finished,
            a manifest that is wrong, or labels beside some of the clips only.
    """
    if path.is_file():
        found = _manifest_of(path)
        return Dataset((clip_file(path),), **_facts(None if found is None else found[1]))
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder; give a clip or a folder of clips")
    manifest = path / MANIFEST
    if manifest.is_file():
        about = read_manifest(manifest)
        files = [_listed(path, entry) for entry in about.clips]
    else:
        about = None
        videos = (p for p in path.iterdir() if format_of(p, ClipFormat) is not None)
        files = [ClipFile(p, labels_beside(p)) for p in sorted(videos)]
    if not files:
        unfinished = (path / "clips").is_dir()
        hint = "; its rendering is not finished: run that command again" if unfinished else ""
        raise InputError(
            f"{path}: no clips ({', '.join(suffixes_of(ClipFormat))}) in this folder{hint}"
        )
    bare = [f.path.name for f in files if f.labels is None]
    if 0 < len(bare) < len(files):
        raise InputError(
            f"{path}: {len(bare)} of {len(files)} clips have no labels beside them (the first is "
            f"{bare[0]}); label all of them or none"
        )
    return Dataset(tuple(files), **_facts(about))


def clip_file(path: Path) -> ClipFile:
    """A clip with what lies beside it: its labels, and what the manifest of its folder tells.

    Raises:
        InputError: no such file, or a manifest that is wrong.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a clip")
    found = _manifest_of(path)
    if found is not None:
        folder, about = found
        for entry in about.clips:
            if (folder / entry.file).resolve() == path.resolve():
                return _listed(folder, entry)
    return ClipFile(path, labels_beside(path))


def read_manifest(path: Path) -> Manifest:
    """The content of a ``dataset.json``.

    Raises:
        InputError: not such a manifest, or one that lists files that are not there or not in its
            folder.
    """
    about = read_json(path, Manifest, "a manifest of clips")
    for entry in about.clips:
        listed = path.parent / entry.file
        for file in (listed, labels_beside(listed)):
            if file is not None and not _is_below(file, path.parent):
                raise InputError(
                    f"{path}: lists {entry.file}, which is not in its folder; move it there"
                )
    missing = [e.file for e in about.clips if not (path.parent / e.file).is_file()]
    if missing:
        raise InputError(f"{path}: lists {missing[0]}, which is not there; {len(missing)} missing")
    return about


def _is_below(file: Path, folder: Path) -> bool:
    """Whether a file lies in a folder, wherever links lead."""
    return file.resolve().is_relative_to(folder.resolve())


def _manifest_of(clip: Path) -> tuple[Path, Manifest] | None:
    """The manifest of the folder that a clip lies in, or of the one above, with that folder."""
    for folder in (clip.resolve().parent, clip.resolve().parent.parent):
        if (folder / MANIFEST).is_file():
            return folder, read_manifest(folder / MANIFEST)
    return None


def _listed(folder: Path, entry: Listed) -> ClipFile:
    path = folder / entry.file
    labels = labels_beside(path)
    for file, held in ((path, entry.sha256), (labels, entry.labels_sha256)):
        if file is not None and held is not None and sha256(file) != held:
            raise InputError(
                f"{file}: not the file that {folder / MANIFEST} lists (its sha256 differs); make "
                "it again, or take its hash out of the list where it was changed on purpose"
            )
    truth = None if entry.truth is None else folder / entry.truth
    return ClipFile(path, labels, entry.coupling, entry.mass, truth)


def _facts(about: Manifest | None) -> dict[str, Any]:
    if about is None:
        return {}
    return {key: getattr(about, key) for key in ("half_extent", "identical", "conserving")}
