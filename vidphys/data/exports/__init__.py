"""What a run or a store holds, written as other people's tools read it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from vidphys.data.exports.episodes import Episode, episodes_of
from vidphys.data.exports.lerobot import write_lerobot
from vidphys.data.exports.shards import write_shards
from vidphys.data.exports.tables import write_tables
from vidphys.errors import InputError

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
    partial = out.with_name(f".{out.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    try:
        partial.mkdir(parents=True)
        count = EXPORTS[form](partial, episodes)
        if out.exists():
            out.rmdir()
        partial.replace(out)
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return count
