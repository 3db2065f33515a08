"""What a verb leaves, so far as a cut and a whole run of it must agree."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pyarrow.parquet as pq
from safetensors import safe_open

from encoders.placing import STALE_SECONDS
from encoders.shards import OWN, Shards
from tests.shared.stored import parts_of

TIMED = ("seconds", "created")  # columns that two runs need not share
SPENT = re.compile(rb"\d+ seconds? of one core")  # in a page
LOCKS = (".lock", "lock")
Remains = dict[str, object]


def left(disk: Path) -> Remains:
    """The content of each file by its name, but of locks and what is being written.

    A checkpoint that is written once more at the same step is called so: that name is left out.
    """
    files = sorted(path for path in disk.rglob("*") if path.is_file() and not passing(path))
    return {str(p.relative_to(disk)).replace("-again.", "."): content(p) for p in files}


def passing(path: Path) -> bool:
    """A lock, or a part that has been touched of late: a killed one's child may be at it."""
    part = ".partial" in path.suffixes and time.time() - path.stat().st_mtime < STALE_SECONDS
    return part or path.name in LOCKS


def content(path: Path) -> object:
    """Its bytes; of tensors the words beside them come in any order, and rows lose their times.

    Of an index of shards, its entries with their tensors; what else lies in shards nobody reads.
    Of a checkpoint its words, but not the name and the hash of the file of its tensors. Of what a
    run says of itself not when it began, in which two quick runs may agree and a third not.
    """
    if path.name == "run.json":
        told = json.loads(path.read_bytes())
        return {key: value for key, value in told.items() if key not in (*TIMED, "seal")}
    if path.name == f"{OWN}.sqlite":
        shards = Shards(path.parent)
        return {
            row.key: (row.manifest, shards.tensors(row).values.tobytes()) for row in shards.rows()
        }
    if path.parent.joinpath(f"{OWN}.sqlite").exists():
        return b""
    if path.suffix == ".entry":
        return parts_of(path)[0]
    if path.suffix == ".json" and b'"tensors"' in (whole := path.read_bytes()):
        told = json.loads(whole)  # of a checkpoint, whose tensors are compared for themselves
        return told.get("meta", told)
    if path.suffix == ".parquet":
        table = pq.read_table(path)
        kept = table.drop_columns([name for name in TIMED if name in table.column_names])
        return [repr(row) for row in kept.to_pylist()]
    if path.suffix != ".safetensors":
        return SPENT.sub(b"", path.read_bytes())
    with safe_open(path, "numpy") as file:
        arrays = [(key, file.get_tensor(key)) for key in sorted(file.keys())]
        about = {k: v for k, v in sorted((file.metadata() or {}).items()) if k != "seal"}
    return repr([about, *((key, a.dtype, a.shape, a.tobytes()) for key, a in arrays)])


def shared(first: Remains, second: Remains) -> Remains:
    """What two undisturbed runs have in common; of the rest, as it tells times, only the names."""
    assert first.keys() == second.keys(), first.keys() ^ second.keys()
    return {name: value if value == second[name] else None for name, value in first.items()}


def differing(disk: Path, whole: Remains) -> list[str]:
    """Files that are missing, too many, or others than all undisturbed runs leave."""
    now = left(disk)
    wrong = now.keys() ^ whole.keys()
    told = {name for name, value in whole.items() if value is not None}
    return sorted(wrong | {name for name in told & now.keys() if now[name] != whole[name]})
