"""The program that reads one Parquet, MATLAB or C3D file, one workbook, or tracks of animals.

Its message says the name, type and shape of each array; their bytes follow, in that order.
"""

from __future__ import annotations

import contextlib
import sys
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
from confined import BYTES, FILE, RefusedError, allow, confine, refusing, require_room, send

SPACE = 3  # coordinates of a marker
DEEPEST = 20  # structures and cells in each other


def main(kind: str, memory: int, seconds: int, most_bytes: int, most_columns: int) -> None:
    """Read the file.

    Args:
        kind: of it, of :data:`READERS`.
        memory: bytes that may be asked for, on top of those of the libraries.
        seconds: of processor time.
        most_bytes: of numbers.
        most_columns: of a table.
    """
    what, prepare, read = READERS[kind]
    prepare()
    confine(memory)
    allow(seconds)
    with refusing(what, memory):
        send(read(most_bytes, most_columns))


def _prepare_parquet() -> None:
    """Imports need files, which are not to be opened later."""
    import arrowed  # noqa: F401
    import pyarrow.parquet  # noqa: F401


def _parquet(most_bytes: int, most_columns: int) -> dict[str, np.ndarray]:
    import pyarrow as pa
    import pyarrow.parquet as pq
    from arrowed import longest, plain

    with pq.ParquetFile(FILE) as file:
        about, schema = file.metadata, file.schema_arrow
        if about.num_columns > most_columns:
            raise RefusedError(f"{about.num_columns} columns, more than {most_columns}")
        twice = [name for name, times in Counter(schema.names).items() if times > 1]
        if twice:
            raise RefusedError(f"two columns are called {twice[0]}; give each a name of its own")
        # pages of equal values are small in a file, and large as numbers
        require_room((about.num_rows, about.num_columns), most_bytes, "a table")
        groups = (about.row_group(k) for k in range(about.num_row_groups))
        held = sum(group.total_byte_size for group in groups)
        require_room((-(-held // BYTES),), most_bytes, "a table")
        columns = {}
        for field in schema:
            if pa.types.is_nested(field.type):
                raise RefusedError(f"column {field.name}: holds more than a number in a cell")
            column = file.read([field.name], use_threads=False).column(0)
            require_room((len(column), longest(column)), most_bytes, f"column {field.name}:")
            columns[field.name] = plain(column)
    return columns


def _prepare_matlab() -> None:
    """See :func:`_prepare_parquet`."""
    import scipy.io
    import scipy.sparse  # noqa: F401


def _matlab(_most_bytes: int, _most_columns: int) -> dict[str, np.ndarray]:
    from scipy.io import loadmat

    with open(FILE, "rb") as file:  # noqa: PTH123 - the file that is given
        held = loadmat(file, struct_as_record=False, squeeze_me=True)
    return dict(_numbers({k: v for k, v in held.items() if not k.startswith("__")}))


def _numbers(held: Any, name: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Numbers of a structure, however deep, by the last name that leads to them."""
    if isinstance(held, dict):
        for key, value in held.items():
            yield from _numbers(value, key)
    elif hasattr(held, "_fieldnames"):
        for key in held._fieldnames:
            yield from _numbers(getattr(held, key), key)
    elif isinstance(held, np.ndarray) and held.dtype == object:
        for number, value in enumerate(held.ravel()):
            yield from _numbers(value, f"{name} {{{number + 1}}}")
    elif isinstance(held, np.ndarray | int | float) and np.asarray(held).dtype.kind in "fiub":
        yield name, np.asarray(held, float)


def _prepare_matlab_7_3() -> None:
    """See :func:`_prepare_parquet`."""
    import hdf5  # noqa: F401


def _matlab_7_3(most_bytes: int, _most_columns: int) -> dict[str, np.ndarray]:
    import h5py

    with h5py.File(FILE, "r") as file:
        return dict(_hdf5_numbers(file, file, [most_bytes], DEEPEST))


def _hdf5_numbers(
    file: Any, held: Any, room: list[int], deep: int, name: str = ""
) -> Iterator[tuple[str, np.ndarray]]:
    """The same of a file of version 7.3, in which cells are references.

    Args:
        file: it.
        held: a group or an array of it.
        room: bytes that are left for numbers.
        deep: how many levels may be below it.
        name: that leads to it.
    """
    import h5py
    from hdf5 import in_here, is_own

    if not deep:
        raise RefusedError(f"{name}: structures in more than {DEEPEST} levels")
    if isinstance(held, h5py.Group):
        for key in held:
            if not key.startswith("#") and is_own(held, key):
                yield from _hdf5_numbers(file, held[key], room, deep - 1, key)
    elif "MATLAB_empty" in held.attrs or held.shape is None:
        return
    elif h5py.check_ref_dtype(held.dtype):
        require_room(held.shape, room[0], name)
        for number, cell in enumerate(in_here(held)[()].T.ravel(), 1):
            yield from _hdf5_numbers(file, file[cell], room, deep - 1, f"{name} {{{number}}}")
    elif held.dtype.kind in "fiub" and held.attrs.get("MATLAB_class") != b"char":
        require_room(held.shape, room[0], name)
        room[0] -= held.size * BYTES  # cells may be the same numbers again and again
        yield name, np.asarray(in_here(held)[()].T.squeeze(), float)


def _prepare_c3d() -> None:
    """See :func:`_prepare_parquet`; names in Latin 1 need a file too, and warnings their lines."""
    import codecs
    import warnings

    import c3d  # noqa: F401

    codecs.lookup("latin-1")
    warnings.simplefilter("ignore")


def _c3d(most_bytes: int, most_columns: int) -> dict[str, np.ndarray]:
    """Places of markers ``(t, n, 3)``, their names, the rate and the unit."""
    import c3d

    with open(FILE, "rb") as file:  # noqa: PTH123 - the file that is given
        reader = c3d.Reader(file)
        names = [" ".join(label.split()) for label in reader.point_labels[: reader.point_used]]
        if len(names) > most_columns:
            raise RefusedError(f"{len(names)} markers, more than {most_columns}")
        require_room((reader.frame_count, len(names), SPACE), most_bytes, "frames by markers")
        places = []
        for _, points, _analog in reader.read_frames(copy=False):
            # the residual is -1 where no camera saw it; some systems say (0, 0, 0) instead
            seen = (points[:, SPACE] >= 0) & points[:, :SPACE].any(-1)
            places.append(np.where(seen[:, None], points[:, :SPACE], np.nan))
        unit = reader.get("POINT:UNITS")
    return {
        "places": np.array(places, float).reshape(-1, len(names), SPACE),
        "frames": np.array(reader.frame_count),  # more where it ends early
        "names": np.array(names, str),
        "rate": np.array(float(reader.point_rate)),
        "unit": np.array("" if unit is None else unit.string_value.strip()),
    }


def _prepare_workbook() -> None:
    """See :func:`_prepare_parquet`."""
    import python_calamine  # noqa: F401


def _workbook(most_bytes: int, most_columns: int) -> dict[str, np.ndarray]:
    """The sheet with most numbers, a line of text for each row."""
    from python_calamine import CalamineWorkbook

    with open(FILE, "rb") as file:  # noqa: PTH123 - the file that is given
        book = CalamineWorkbook.from_filelike(file)
    best, most = [], -1
    for name in book.sheet_names:
        sheet = book.get_sheet_by_name(name)
        require_room((sheet.total_height, sheet.total_width), most_bytes, f"sheet {name}:")
        if sheet.total_width > most_columns:
            raise RefusedError(
                f"sheet {name}: {sheet.total_width} columns, more than {most_columns}"
            )
        rows = sheet.to_python(skip_empty_area=True)
        numbers = sum(isinstance(cell, float | int) for row in rows for cell in row)
        if numbers > most:
            best, most = rows, numbers
    lines = ["\t".join(" ".join(str(cell).split()) for cell in row) for row in best]
    require_room((len(lines), max(map(len, lines), default=0) / 2), most_bytes, "a sheet")
    return {"lines": np.array(lines, str)}


def _prepare_tracks() -> None:
    """See :func:`_prepare_parquet`."""
    import tracks  # noqa: F401


def _tracks(most_bytes: int, _most_columns: int) -> dict[str, np.ndarray]:
    """SLEAP's or DeepLabCut's; nothing of another's."""
    import h5py
    from tracks import deeplabcut, sleap

    with h5py.File(FILE, "r") as file:
        return sleap(file, most_bytes) or deeplabcut(file, most_bytes)


READERS = {
    "c3d": ("a C3D file", _prepare_c3d, _c3d),
    "matlab 7.3": ("a MATLAB file", _prepare_matlab_7_3, _matlab_7_3),
    "parquet": ("a table", _prepare_parquet, _parquet),
    "matlab": ("a MATLAB file", _prepare_matlab, _matlab),
    "tracks": ("a file of tracks", _prepare_tracks, _tracks),
    "workbook": ("a workbook", _prepare_workbook, _workbook),
}


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        main(sys.argv[1], *map(int, sys.argv[2:]))
