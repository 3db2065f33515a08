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
from contextlib import suppress
from pathlib import Path

MANIFEST = "run.json"
ASIDE = re.compile(r"\.given-up-\d+")
FORGOTTEN = re.compile(r"\.forgotten-\d+")
# With the process that writes it; a video ends in its container.
PARTIAL = re.compile(r"\..+\.(?P<writer>\d+)\.partial(\.\w+)?", re.DOTALL)
STALE_SECONDS = 3600.0  # without a change, after which a file is nobody's


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
        named = PARTIAL.fullmatch(path.name)
        if named and (path.is_file() or path.is_symlink()) and not _is_written(path, named):
            path.unlink(missing_ok=True)


def _is_written(path: Path, named: re.Match[str]) -> bool:
    """Whether another process may be writing it: a recording is saved without the run's lock."""
    writer = int(named["writer"])
    if writer == os.getpid():  # it has written nothing yet, so another had its number
        return False
    try:
        os.kill(writer, 0)  # sends nothing
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # another user's
        pass
    with suppress(FileNotFoundError):  # it has been finished meanwhile
        return time.time() - path.lstat().st_mtime < STALE_SECONDS
    return False
