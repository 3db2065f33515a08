"""Files that are whole or not there."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path

STALE_SECONDS = 3600.0  # without a change, after which a part is nobody's


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Where to write what becomes ``path`` once all of it lies on the disk.

    It is of the same kind by its name, and of one that a run folder sweeps after a kill; outside of
    run folders the next that writes ``path`` deletes what killed ones left.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for part in path.parent.glob(f".{escape(path.stem)}.*.partial{escape(path.suffix)}"):
        with suppress(OSError):  # another process sweeps too
            if time.time() - part.lstat().st_mtime > STALE_SECONDS:
                part.unlink()
    part = path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        yield part
        with part.open("rb") as file:
            os.fsync(file.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
