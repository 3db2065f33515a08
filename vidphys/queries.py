"""SQL over the numbers of several runs."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from vidphys.errors import InputError
from vidphys.opened import open_run
from vidphys.runs.records import EPISODE_SCHEMA, RECORD_SCHEMA

ALONE: dict[
    str, str | bool | int | float | list[str]
] = {  # no file is read or written, nothing is fetched, and no variable of Python is a table
    "enable_external_access": False,
    "autoinstall_known_extensions": False,
    "autoload_known_extensions": False,
    "python_enable_replacements": False,
}


def query(sql: str, *paths: Path | str) -> pa.Table:
    """Ask the tables ``records`` and ``episodes`` of some runs, each with a column ``run``.

    Args:
        sql: DuckDB's, of these two tables; see :data:`vidphys.runs.records.RECORD_SCHEMA`.
        paths: folders of runs; ``run`` is a folder as it is given here. What is not finished has
            no rows.

    Raises:
        InputError: no such run, or something that cannot be asked.

    Example:
        >>> import tempfile
        >>> from vidphys.runs.folder import RunFolder
        >>> from vidphys.runs.records import Origin, Recorder
        >>> home = Path(tempfile.mkdtemp())
        >>> for name, value in (("a", 0.5), ("b", 0.25)):
        ...     folder = RunFolder.open(home / name, {"cells": ["oracle/factored"], "seeds": [0]})
        ...     recorder = Recorder(Origin("ladder", "oracle/factored", *["none"] * 5, "factored",
        ...                                0, "cpu", "float32"))
        ...     recorder.add_value("inversion_nmse", value)
        ...     folder.finish("oracle-factored-s0", *recorder.tables())
        ...     table = folder.join()
        ...
        >>> asked = "select avg(value) mean, count(*) runs from records"
        >>> found = query(asked, home / "a", home / "b")
        >>> found.to_pylist()
        [{'mean': 0.375, 'runs': 2}]
    """
    import duckdb

    runs = [open_run(path) for path in paths]
    with duckdb.connect(":memory:", config=ALONE) as database:
        for kind, schema in (("records", RECORD_SCHEMA), ("episodes", EPISODE_SCHEMA)):
            done = [run for run in runs if (run.path / f"{kind}.parquet").is_file()]
            parts = [_of(run.path, getattr(run, kind)) for run in done]
            nothing = _of(Path(), schema.empty_table())
            whole = pa.concat_tables([nothing, *parts], promote_options="default")
            database.register(kind, whole)
        try:
            found = database.sql(sql)
            if found is None:
                raise InputError("query: it asks for no rows; write a select")
            return found.to_arrow_table()
        except duckdb.Error as error:
            raise InputError(f"query: {str(error).splitlines()[0]}") from error


def _of(run: Path, table: pa.Table) -> pa.Table:
    """A table with the run that it is of, in front."""
    names = pa.array([str(run)] * len(table), pa.string())
    return table.replace_schema_metadata(None).add_column(0, "run", names)
