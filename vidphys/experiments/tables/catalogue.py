"""All tables by name; a new one is one line."""

from __future__ import annotations

from vidphys.experiments.tables.base import Table
from vidphys.experiments.tables.gravity import INVERSION, STABILITY

TABLES: dict[str, Table] = {table.name: table for table in (STABILITY, INVERSION)}
