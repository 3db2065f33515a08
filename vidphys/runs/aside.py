"""A run that is given up lies aside, whole, until the one in its place is finished.

Its ``run.json`` is moved last, both ways, so that a stop at any instant can be told and undone:
aside without ``run.json``, it was on its way out; a folder without, and it was on its way back.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Iterable
from pathlib import Path

MANIFEST = "run.json"
ASIDE = re.compile(r"\.given-up-\d+")
FORGOTTEN = re.compile(r"\.forgotten-\d+")
PARTIAL = re.compile(r"\..+\.\d+\.partial(\.\w+)?", re.DOTALL)  # a video ends in its container


def move_aside(folder: Path, names: Iterable[str]) -> None:
    """Put what has one of these ``names`` aside, ``run.json`` last."""
    aside = folder / f".given-up-{time.time_ns():020d}"
    aside.mkdir()
    _move([folder / name for name in names], aside)


def settle(folder: Path) -> None:
    """Undo a moving that was stopped half-way, and put back a run whose place nothing took."""
    for aside in _all(folder):
        if not (folder / MANIFEST).exists() or not (aside / MANIFEST).exists():
            _move(list(aside.iterdir()), folder)
            aside.rmdir()
            return


def forget(folder: Path) -> None:
    """Delete what lies aside."""
    for aside in _all(folder):
        aside.rename(folder / aside.name.replace("given-up", "forgotten"))
    _delete_forgotten(folder)


def sweep(folder: Path, names: Iterable[str]) -> None:
    """Delete what a killed process left half-written in ``folder`` and in those of ``names``."""
    _delete_forgotten(folder)
    for path in folder.iterdir():
        if path.name in names and path.is_dir() and not path.is_symlink():
            for where, _, files in os.walk(path):
                _unlink_partial(Path(where, name) for name in files)
    _unlink_partial(list(folder.iterdir()))


def is_ours(path: Path) -> bool:
    """Whether only a run leaves something of this name."""
    return any(kind.fullmatch(path.name) for kind in (ASIDE, FORGOTTEN, PARTIAL))


def _all(folder: Path) -> list[Path]:
    found = (path for path in folder.iterdir() if ASIDE.fullmatch(path.name))
    return sorted((path for path in found if not path.is_symlink()), reverse=True)


def _delete_forgotten(folder: Path) -> None:
    for path in list(folder.iterdir()):
        if FORGOTTEN.fullmatch(path.name) and not path.is_symlink():
            shutil.rmtree(path)


def _move(paths: list[Path], into: Path) -> None:
    for path in sorted(paths, key=lambda path: path.name == MANIFEST):
        if path.exists() or path.is_symlink():
            path.rename(into / path.name)


def _unlink_partial(paths: Iterable[Path]) -> None:
    for path in paths:
        if PARTIAL.fullmatch(path.name) and (path.is_file() or path.is_symlink()):
            path.unlink(missing_ok=True)
