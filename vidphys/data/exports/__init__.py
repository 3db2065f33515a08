"""What a run or a store holds, written as other people's tools read it."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from uuid import uuid4

from vidphys.data.exports.episodes import Episode, episodes_of
from vidphys.data.exports.lerobot import write_lerobot
from vidphys.data.exports.shards import write_shards
from vidphys.data.exports.tables import write_tables
from vidphys.errors import InputError

NAME = 200  # letters of a folder's name, of which one beside it is called
EXPORTS: dict[str, Callable[[Path, Iterator[Episode]], int]] = {
    "parquet": write_tables,
    "lerobot": write_lerobot,
    "webdataset": write_shards,
}


def export(source: Path, out: Path, form: str) -> int:
    """Write what lies in a folder into another one, whole or not at all.

    Args:
        source: of a finished `vidphys rollout`, or a feature store.
        out: made; nothing may lie there.
        form: one of :data:`EXPORTS`.

    Returns:
        How many episodes were written.

    Raises:
        InputError: nothing to write, something lies in the way, or it does not fit the form.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: something lies there; choose another folder")
    episodes = episodes_of(source)
    try:
        with _partial(out) as partial:
            count = EXPORTS[form](partial, episodes)
            partial.replace(out)  # onto nothing, or a folder with nothing in it
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from error
    return count


@contextmanager
def _partial(out: Path) -> Iterator[Path]:
    """A folder beside ``out``, of this process alone; those that killed ones left are deleted."""
    out.parent.mkdir(parents=True, exist_ok=True)
    name = f".{out.name[:NAME]}."
    for stale in out.parent.glob(f"{escape(name)}*.partial"):
        with suppress(OSError), _held(stale):
            shutil.rmtree(stale)
    partial = out.with_name(f"{name}{uuid4().hex}.partial")
    partial.mkdir()
    try:
        with _held(partial):
            yield partial
    finally:
        shutil.rmtree(partial, ignore_errors=True)


@contextmanager
def _held(folder: Path) -> Iterator[None]:
    """A folder that nobody else holds, told without a file in it.

    Raises:
        BlockingIOError: another process does.
    """
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(number)
