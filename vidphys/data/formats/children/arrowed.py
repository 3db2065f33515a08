"""Columns of Arrow as arrays of numpy; not called as Arrow is, whose place it would take."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from confined import RefusedError

Column: TypeAlias = pa.Array | pa.ChunkedArray


def is_words(kind: pa.DataType) -> bool:
    """Whether cells are words."""
    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def is_list(kind: pa.DataType) -> bool:
    """Whether cells are lists."""
    lists = pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list
    return any(is_one(kind) for is_one in lists)


def is_plain(kind: pa.DataType) -> bool:
    """Whether cells are numbers, times or words, or lists of them, however deep."""
    while is_list(kind):
        kind = kind.value_type
    numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
    return numbers or pa.types.is_timestamp(kind) or is_words(kind)


def longest(column: Column) -> int:
    """Bytes of the longest word; 1 where there are none."""
    return (pc.max(pc.binary_length(column)).as_py() or 0) if is_words(column.type) else 1


def plain(column: Column) -> np.ndarray:
    """A column as numbers, times or words."""
    if isinstance(column, pa.Array):  # which would look for pandas, when no file may be opened
        column = pa.chunked_array([column])
    found = column.to_numpy(zero_copy_only=False)
    if found.dtype != object:
        return found
    return np.array(["" if cell is None else str(cell) for cell in found.tolist()], dtype=str)


def lengths(column: Column) -> np.ndarray:
    """Of lists; 0 where there is none."""
    return np.nan_to_num(plain(pc.list_value_length(column))).astype(int)


def nested(column: Column, name: str) -> np.ndarray | list[np.ndarray]:
    """A column of lists, however deep: one array, or one a row where they are of unequal shapes.

    Raises:
        RefusedError: the lists of one row are of unequal lengths.
    """
    whole = _level(column)
    if whole is not None:
        return whole
    rows = [_level(column.slice(k, 1)) for k in range(len(column))]
    if any(row is None for row in rows):
        raise RefusedError(f"column {name}: lists of unequal lengths in one row")
    return [row[0] for row in rows if row is not None]


def _level(column: Column) -> np.ndarray | None:
    """Lists of equal lengths as an array, nothing where they are not."""
    shape = [len(column)]
    while is_list(column.type):
        known = list(set(lengths(column).tolist()))
        if len(known) > 1:
            return None
        shape += known or [0]
        column = pc.list_flatten(column)
    return plain(column).reshape(shape)
