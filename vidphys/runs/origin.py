"""Which code made a part of a run, and whether that has changed since: kept with its tables."""

from __future__ import annotations

import pyarrow as pa

from vidphys.runs.code import code_hash, code_version
from vidphys.seeding import role_of

MADE_BY = b"code_version"  # in the metadata of a part's tables
MADE_OF = b"code_hash"  # likewise
MAKERS = b"code_modules"  # likewise: those whose hash that is, none for all


def made_here(makers: tuple[str, ...]) -> dict[bytes, bytes]:
    """Metadata of tables that this code makes.

    Args:
        makers: modules that define what made them, see :func:`vidphys.runs.code.code_hash`.
    """
    return {
        MADE_BY: code_version().encode(),
        MADE_OF: code_hash(makers).encode(),
        MAKERS: " ".join(makers).encode(),
    }


def maker_of(part: pa.Table) -> str | None:
    """The version of the code that made a part's table, where it says so."""
    version = (part.schema.metadata or {}).get(MADE_BY)
    return None if version is None else version.decode()


def with_origin(part: pa.Table) -> pa.Table:
    """A part's table with what its seeds are for and which code made it.

    A part that does not say of what code it is made counts as stale.
    """
    told, version = part.schema.metadata or {}, maker_of(part)
    now = code_hash(tuple(told.get(MAKERS, b"").decode().split()))
    count, seeds = len(part), part["seed"].to_pylist()
    columns = {
        "role": pa.array([role_of(seed) for seed in seeds], pa.string()),
        "code_version": pa.array([version] * count, pa.string()),
        "stale": pa.array([told.get(MADE_OF) != now.encode()] * count, pa.bool_()),
    }
    part = part.replace_schema_metadata()
    for name, column in columns.items():
        part = part.append_column(name, column)
    return part
