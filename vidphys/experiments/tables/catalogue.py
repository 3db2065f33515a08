"""All tables by name; a new one is one line."""

from __future__ import annotations

from vidphys.experiments.tables import gravity, sweeps
from vidphys.experiments.tables.base import Table

TABLES: dict[str, Table] = {
    table.name: table
    for table in (
        gravity.STABILITY,
        gravity.INVERSION,
        gravity.DISSOCIATION,
        gravity.GRAPH_NETS,
        gravity.BASELINES,
        gravity.EXTRAPOLATION,
        sweeps.CAPACITY,
        sweeps.DATA,
        sweeps.SENSITIVITY,
    )
}
