"""Files that are whole or not there: written beside their name, synced, renamed into place."""

from __future__ import annotations

import os
import time
import uuid
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

STALE_SECONDS = 3600.0  # without a change, after which a partial file is nobody's
AT_ONCE = 16  # files that are synced side by side


def partial_of(path: Path) -> Path:
    """A name beside ``path`` that nobody else uses, on no machine."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.partial")


def place(files: Mapping[Path, Path]) -> None:
    """Sync all files, then rename them in order.

    Args:
        files: each with its place.
    """
    if len(files) == 1:
        _sync(*files)
    else:  # a disk writes its journal once for all that wait for it
        with ThreadPoolExecutor(min(AT_ONCE, len(files))) as pool:
            for _ in pool.map(_sync, files):  # an error of any is raised here
                pass
    for file, path in files.items():
        file.replace(path)


@contextmanager
def placed(path: Path) -> Iterator[Path]:
    """A neighbour of ``path`` to be filled, which is then synced and renamed; gone on an error."""
    partial = partial_of(path)
    try:
        yield partial
        _sync(partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def sweep(folder: Path, *patterns: str) -> None:
    """Delete what killed processes left half-written, which nobody has touched for long.

    Args:
        folder: swept.
        patterns: of names; half-written files where none are given. Of others, those that have no
            manifest beside them count as such.
    """
    for path in (path for pattern in patterns or (".*.partial",) for path in folder.glob(pattern)):
        with suppress(OSError):  # another process sweeps too
            stale = time.time() - path.lstat().st_mtime > STALE_SECONDS
            if stale and not path.with_suffix(".json").exists():
                path.unlink()


def _sync(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())
