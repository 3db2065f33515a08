"""Which column of a table is what: times, clips, bodies and coordinates, by their usual names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vidphys.errors import InputError

ROLES = {
    "time": ("t", "time", "times", "time_s", "seconds", "timestamp"),
    "frame": ("frame", "frames", "frame_number", "index"),
    "clip": ("clip", "episode", "trial", "run", "video", "sequence"),
    "body": ("body", "id", "track", "track_id", "object", "particle", "label"),
    "mass": ("mass", "m"),
    "coupling": ("coupling", "g", "strength"),
}
AXES = ("x", "y", "z")
ANGLES = ("theta", "angle", "phi", "o")
COORDINATE = re.compile(r"^(x|y|z|u|v|q|theta|angle|phi|o|pos_?x|pos_?y|pos_?z)_?(\d*)$")


@dataclass(frozen=True)
class Columns:
    """Columns of a table by what they are.

    Args:
        time, frame, clip, body, mass, coupling: names, or ``None``.
        coordinates: by body (in the table's order), the column of each axis; a long table, with a
            body in each row, has one entry.
        angles: whether the coordinate is an angle.
        pixels: whether coordinates are pixels, counted downwards.
    """

    time: str | None
    frame: str | None
    clip: str | None
    body: str | None
    mass: str | None
    coupling: str | None
    coordinates: tuple[tuple[str, ...], ...]
    angles: bool = False
    pixels: bool = False


def detect_columns(names: Sequence[str], given: Mapping[str, str] | None = None) -> Columns:
    """Tell columns by their names.

    Args:
        names: of all columns, in their order.
        given: what some columns are (``{"time": "T_s", "x1": "left"}``), where their names do
            not tell. Where coordinates are given, the table's others are left out.

    Raises:
        InputError: a column that was given is not there, or no coordinates were found.
    """
    given = dict(given or {})
    for role, name in given.items():
        if name not in names:
            raise InputError(
                f"`columns` {role}={name}: no such column; the table has {', '.join(names)}"
            )
    told = {name: role for role, name in given.items()}
    called = {name: told.get(name, name.strip().lower()) for name in names}
    roles = {role: _first(called, (role, *usual)) for role, usual in ROLES.items()}
    chosen = {name for name, role in told.items() if COORDINATE.match(role)}
    found = {name: COORDINATE.match(called[name]) for name in names if name in (chosen or names)}
    places = {name: match for name, match in found.items() if match}
    bodies = _bodies(places)
    if not bodies:
        raise InputError(
            f"no coordinates among the columns {', '.join(names)}; name them x, y or x1, y1, x2, "
            "..., or say which they are with `columns` x=NAME y=NAME"
        )
    kinds = {_axis(match) for match in places.values()}
    return Columns(
        **roles,
        coordinates=bodies,
        angles=bool(kinds & set(ANGLES)) and not kinds & set(AXES),
        pixels="u" in kinds,
    )


def _first(called: Mapping[str, str], usual: Sequence[str]) -> str | None:
    for text in usual:
        for name, call in called.items():
            if call == text:
                return name
    return None


def _axis(match: re.Match[str]) -> str:
    return match.group(1).replace("pos", "").strip("_")


def _bodies(places: Mapping[str, re.Match[str]]) -> tuple[tuple[str, ...], ...]:
    """Columns of each body: pixels (u, v), or places (x, y, z), or one angle or coordinate."""
    axes = {_axis(match) for match in places.values()}
    wanted: tuple[str, ...]
    if "u" in axes and "v" in axes and not axes & set(AXES):
        wanted = ("u", "v")
    elif axes & set(AXES):
        wanted = tuple(axis for axis in AXES if axis in axes)
    else:
        wanted = next(((a,) for a in (*ANGLES, "q") if a in axes), ())
    by_body: dict[str, dict[str, str]] = {}
    for name, match in places.items():
        if _axis(match) in wanted:
            by_body.setdefault(match.group(2), {})[_axis(match)] = name
    for number, columns in by_body.items():
        missing = [axis for axis in wanted if axis not in columns]
        if missing:
            raise InputError(
                f"body {number or 1}: columns {', '.join(columns.values())}, but no "
                f"{', '.join(missing)}; every body needs the same axes"
            )
    order = sorted(by_body, key=lambda number: int(number or 0))
    return tuple(tuple(by_body[number][axis] for axis in wanted) for number in order)
