"""Which cells of a run can be looked at, and the file of each."""

from __future__ import annotations

from pathlib import Path

from vidphys.errors import InputError
from vidphys.runs.records import read_table


def recordings_of(run: Path) -> dict[str, Path]:
    """The file of each cell that can be shown, by the cell's name.

    It is a recording (``.rrd``), or a showcase (``.safetensors``) from which one is drawn.
    """
    showcases, recordings = run / "showcase", run / "recordings"
    files = (*showcases.glob("*.safetensors"), *recordings.glob("*.rrd"))
    found = {file.stem: file for file in files}
    names = {name.replace("/", "-"): name for name in _recorded_cells(run)}
    return {names.get(stem, stem): found[stem] for stem in sorted(found)}


def _recorded_cells(run: Path) -> list[str]:
    """The names in the records: file names alone do not tell where the grounding ends."""
    try:
        column = read_table(run / "records.parquet")["cell"]
    except (InputError, KeyError):
        return []
    return sorted(set(column.to_pylist()))
