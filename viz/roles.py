"""What seeds are for: confirmation is reported; development, looked at in tuning, stands greyed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from viz.summary import Records

DEVELOPMENT = "development"
T = TypeVar("T", bound=Mapping[str, Any])


def roles(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """What the rows' seeds are for; confirmation first. Older runs do not say it."""
    return sorted({role_of(row) for row in rows})


def role_of(row: Mapping[str, Any]) -> str:
    """What one row's seeds are for, or nothing where it does not say so."""
    return row.get("role") or ""


def first(rows: Sequence[T]) -> list[T]:
    """The rows that are reported: of confirmation where there are any."""
    shown = roles(rows)[:1]
    return [row for row in rows if role_of(row) in shown]


def by_role(records: Records) -> tuple[Records, Records | None]:
    """What is reported first, and the development seeds' records where there are others.

    Seeds of confirmation alone are reported where there are any.
    """
    shown = first(records.rows)
    others = [row for row in records.rows if role_of(row) != role_of(shown[0])]
    return Records(shown), Records(others) if others else None


def looked_at(records: Records) -> str:
    """Why the seeds of development stand apart."""
    seeds = sorted({int(row["seed"]) for row in records.rows})
    return (
        f"Seeds {', '.join(map(str, seeds))} were looked at while the code was tuned: they confirm "
        "nothing. All that stands above is of the others."
    )


def named(records: Records) -> str:
    """The seeds, and what each group of them is for."""
    groups: dict[str, set[int]] = {}
    for row in records.rows:
        groups.setdefault(role_of(row), set()).add(int(row["seed"]))
    return "; ".join(
        ", ".join(map(str, sorted(seeds))) + (f" ({role})" if role else "")
        for role, seeds in sorted(groups.items())
    )
