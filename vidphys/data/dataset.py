"""What a training is given: one clip, a folder of the user's clips, or a rendered folder.

A folder may hold ``dataset.json``, which a rendered one always does and a user may write:
``half_extent`` (units of the labels' x and y in half of the longer image side), ``identical``
(bodies that look alike), ``conserving`` (no friction in it) and ``clips``, a list of ``file`` with
the ``coupling`` and the ``mass`` of each body. Without it a folder's clips are its video files,
labels are in normalised image units, and coupling and masses are one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from dynamics import Parameters
from vidphys.data.formats import ClipFormat, format_of, suffixes_of
from vidphys.data.labels import labels_beside
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256

MANIFEST = "dataset.json"
SCHEMA_VERSION = 1


@dataclass(frozen=True)
class ClipFile:
    """One clip on disk.

    Args:
        path: the video.
        labels: the table beside it, if there is one.
        coupling: G of the law that held.
        mass: of each body; ones where nothing is said.
    """

    path: Path
    labels: Path | None
    coupling: float = 1.0
    mass: tuple[float, ...] | None = None

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
        return Dataset((clip_file(path),), **_facts(_manifest_of(path)))
    if not path.is_dir():
        raise InputError(f"{path}: no such file or folder; give a clip or a folder of clips")
    manifest = path / MANIFEST
    if manifest.is_file():
        about = read_manifest(manifest)
        files = [_listed(path, entry) for entry in about["clips"]]
    else:
        about = {}
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
    manifest = _manifest_of(path)
    for entry in manifest.get("clips", ()):
        if (Path(manifest["folder"]) / entry["file"]).resolve() == path.resolve():
            return _listed(Path(manifest["folder"]), entry)
    return ClipFile(path, labels_beside(path))


def read_manifest(path: Path) -> dict[str, Any]:
    """The content of a ``dataset.json``, with the ``folder`` that its files are relative to.

    Raises:
        InputError: not JSON, of another schema, or without a list of clips.
    """
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
        files = [entry["file"] for entry in about["clips"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: not a manifest of clips ({error!r})") from error
    if about.get("schema_version", SCHEMA_VERSION) != SCHEMA_VERSION:
        raise InputError(f"{path}: schema version {about['schema_version']}, not {SCHEMA_VERSION}")
    missing = [file for file in files if not (path.parent / file).is_file()]
    if missing:
        raise InputError(f"{path}: lists {missing[0]}, which is not there; {len(missing)} missing")
    home = path.parent.resolve()
    outside = [f for f in files if not (home / f).resolve().is_relative_to(home)]
    if outside:
        raise InputError(f"{path}: lists {outside[0]}, which is not in its folder; move it there")
    return {**about, "folder": str(path.parent)}


def _manifest_of(clip: Path) -> dict[str, Any]:
    """The manifest of the folder that a clip lies in, or of the one above; empty without one."""
    for folder in (clip.resolve().parent, clip.resolve().parent.parent):
        if (folder / MANIFEST).is_file():
            return read_manifest(folder / MANIFEST)
    return {}


def _listed(folder: Path, entry: dict[str, Any]) -> ClipFile:
    path, mass = folder / entry["file"], entry.get("mass")
    for file, key in ((path, "sha256"), (labels_beside(path), "labels_sha256")):
        if file is not None and key in entry and sha256(file) != entry[key]:
            raise InputError(
                f"{file}: not the file that {folder / MANIFEST} lists (its sha256 differs); make "
                "it again, or take its hash out of the list where it was changed on purpose"
            )
    law = float(entry.get("coupling", 1.0)), None if mass is None else tuple(map(float, mass))
    return ClipFile(path, labels_beside(path), *law)


def _facts(about: dict[str, Any]) -> dict[str, Any]:
    return {key: about[key] for key in ("half_extent", "identical", "conserving") if key in about}
