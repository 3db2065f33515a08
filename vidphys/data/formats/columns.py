"""Which column of a table is what: times, clips, bodies and coordinates, by names and numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vidphys.data.formats.names import LENGTHS, PIXELS, RADIANS, ROLES, Meaning, meaning_of
from vidphys.data.formats.points import by_vectors
from vidphys.data.formats.shapes import is_rate_of, numbers_trials, rising
from vidphys.errors import InputError

Table = Mapping[str, np.ndarray]
AXES = ("x", "y", "z")
RESTING = 2  # values of a sensor at rest: one, and the next that it can tell
WAYS = (("u", "v"), AXES, ("angle",), ("q",))  # what bodies are placed by; the first that is there


@dataclass(frozen=True)
class Columns:
    """Columns of a table by what they are.

    Args:
        time, frame, clip, body, mass, coupling: names, or ``None``.
        coordinates: by body, the column of each axis; a long table, with a body in each row, has
            one entry.
        rates, inputs, others: columns that are not taken: velocities and accelerations, what
            drives the bodies and is known, and what is not understood.
        units: by column, where its name says it.
        alone: whether names say only that it is a coordinate, not which.
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
    rates: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    alone: bool = False
    angles: bool = False
    pixels: bool = False


def detect_columns(
    names: Sequence[str], given: Mapping[str, str] | None = None, table: Table | None = None
) -> Columns:
    """Tell columns by their names, and by their numbers where names do not tell.

    Args:
        names: of all columns, in their order.
        given: what some columns are (``{"time": "T_s", "x1": "left"}``), where their names do
            not tell; ``time[ms]`` says a unit too. Where coordinates are given, the table's others
            are left out.
        table: the columns themselves.

    Raises:
        InputError: a column that was given is not there, or no coordinates were found.
    """
    given = dict(given or {})
    for asked, name in given.items():
        if name not in names:
            raise InputError(
                f"`columns` {asked}={name}: no such column; the table has {', '.join(names)}"
            )
        if meaning_of(asked).kind in ("", "measure"):
            raise InputError(
                f"`columns` {asked}={name}: no such role; use {', '.join(ROLES)}, x, y, x1, angle"
            )
    told = {name: role for role, name in given.items()}
    meanings = {name: meaning_of(told.get(name, name)) for name in names}
    chosen = {name for name in told if meanings[name].kind == "place"}
    if chosen:
        meanings = {
            name: Meaning() if means.kind == "place" and name not in chosen else means
            for name, means in meanings.items()
        }
    if not any(means.axis == "u" for means in meanings.values()):  # v alone is a speed
        meanings = {n: Meaning("rate") if m.axis == "v" else m for n, m in meanings.items()}
    elif not any(means.axis == "v" for means in meanings.values()):
        meanings = {n: Meaning("input") if m.axis == "u" else m for n, m in meanings.items()}
    if table is not None:
        meanings = _moving(_by_numbers(meanings, table), table)
    meanings = by_vectors(meanings)
    roles = {role: _first(meanings, role) for role in ROLES}
    bodies = _bodies(meanings)
    if not bodies:
        raise InputError(_no_places(meanings))
    taken = {name for body in bodies for name in body}
    if any(meanings[name].body for name in taken):
        roles["body"] = None  # a row is of several bodies, or of the one that its columns name
    units = {name: means.unit for name, means in meanings.items() if means.unit}
    axes = {meanings[name].axis for name in taken}
    joint = axes == {"q"} and any(means.kind == "input" for means in meanings.values())
    angle = all(units.get(name) in RADIANS for name in taken)
    turned = joint and _torque(meanings) and not any(units.get(name) in LENGTHS for name in taken)
    left = [n for n in names if n not in taken and n not in roles.values()]
    return Columns(
        **roles,
        coordinates=bodies,
        rates=tuple(name for name in left if meanings[name].kind == "rate"),
        inputs=tuple(name for name in left if meanings[name].kind == "input"),
        others=tuple(name for name in left if meanings[name].kind not in ("rate", "input")),
        units=units,
        alone=axes == {"q"},
        angles=axes == {"angle"} or angle or turned,
        pixels="u" in axes or any(units.get(name) in PIXELS for name in taken),
    )


def shown(columns: Columns, table: Table) -> tuple[Columns, tuple[str, ...]]:
    """The columns without those that show nothing, and which these are, a line each.

    Left out are bodies that no row shows or that are where another one is, a third axis along which
    nothing moves, coordinates alone that rest while others move, as those of a sensor that was
    connected but not used, and inputs that never change.
    """
    bodies, lines = columns.coordinates, []
    seen = tuple(body for body in bodies if all(_values(table[name]) for name in body))
    if 0 < len(seen) < len(bodies):
        lines.append(f"{_named(bodies, seen)} left out: no row has a number")
        bodies = seen
    own = tuple(body for k, body in enumerate(bodies) if not _among(body, bodies[:k], table))
    if len(own) < len(bodies):
        lines.append(f"{_named(bodies, own)} left out: always where another one is")
        bodies = own
    if all(len(body) == len(AXES) and _values(table[body[-1]]) < RESTING for body in bodies):
        lines.append(f"{', '.join(body[-1] for body in bodies)} left out: without a change")
        bodies = tuple(body[:-1] for body in bodies)
    moving = tuple(body for body in bodies if len(body) > 1 or _values(table[body[0]]) > RESTING)
    if 0 < len(moving) < len(bodies):
        lines.append(f"{_named(bodies, moving)} left out: at rest")
        bodies = moving
    inputs = tuple(name for name in columns.inputs if _values(table[name]) > 1)
    if len(inputs) < len(columns.inputs):
        constant = ", ".join(name for name in columns.inputs if name not in inputs)
        lines.append(f"{constant} left out: without a change")
    return replace(columns, coordinates=bodies, inputs=inputs), tuple(lines)


def _among(body: tuple[str, ...], others: Sequence[tuple[str, ...]], table: Table) -> bool:
    """Whether one of the others has the same numbers in every row, of a body that moves."""
    return any(_values(table[name]) > RESTING for name in body) and any(
        len(body) == len(other)
        and all(_alike(table[x], table[y]) for x, y in zip(body, other, strict=True))
        for other in others
    )


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two columns hold the same numbers."""
    numbers = all(column.dtype.kind in "fiu" for column in (one, other))
    return numbers and np.array_equal(one.astype(float), other.astype(float), equal_nan=True)


def _named(bodies: Sequence[tuple[str, ...]], kept: Sequence[tuple[str, ...]]) -> str:
    return ", ".join("/".join(body) for body in bodies if body not in kept)


def _values(column: np.ndarray) -> int:
    """How many different numbers a column has; of words, as many as it has rows."""
    if column.dtype.kind not in "fiu":
        return len(column)
    return len(np.unique(column[np.isfinite(column)]))


def _no_places(meanings: Mapping[str, Meaning]) -> str:
    """What is wrong with columns none of which is a place, and what to do."""
    said = f"no coordinates among the columns {', '.join(meanings)}; "
    asked = "name them x, y or x1, y1, x2, ..., or say which they are with `columns` x=NAME y=NAME"
    rates = [name for name, means in meanings.items() if means.kind == "rate"]
    measures = [name for name, means in meanings.items() if means.kind == "measure"]
    if measures:
        said += f"{', '.join(measures)}: the measure of a thing is no place of a body in time; "
    elif rates:
        said += (
            f"{', '.join(rates)}: a law is found from places or angles, which no accelerometer or "
            "gyroscope measures, so film the motion or use a sensor of distance; else "
        )
    return said + asked


def _moving(meanings: Mapping[str, Meaning], table: Table) -> dict[str, Meaning]:
    """Without places that rest while another kind of them moves: a cart's, beside an angle."""
    places = {name: means for name, means in meanings.items() if means.kind == "place"}
    moves = {means.axis for name, means in places.items() if _values(table[name]) > 1}
    ways = [way for way in WAYS if any(means.axis in way for means in places.values())]
    moving = next((way for way in ways if moves & set(way)), None)
    if moving is None or moving == ways[0]:
        return dict(meanings)
    at_rest = [name for name, means in places.items() if means.axis not in moving]
    return {n: Meaning(unit=m.unit) if n in at_rest else m for n, m in meanings.items()}


def _torque(meanings: Mapping[str, Meaning]) -> bool:
    """Whether what drives the bodies turns them."""
    inputs = (name.lower() for name, means in meanings.items() if means.kind == "input")
    return any(word in name for name in inputs for word in ("torque", "tau", "moment", "τ"))


def _first(meanings: Mapping[str, Meaning], role: str) -> str | None:
    return next((name for name, means in meanings.items() if means.kind == role), None)


def _by_numbers(meanings: Mapping[str, Meaning], table: Table) -> dict[str, Meaning]:
    """What names leave open: a first column that rises is the time, one coordinate alone a place.

    Columns that are the rate of another are told by their integral.
    """
    known = _one_time(meanings, table)
    for name in [name for name, means in known.items() if means.kind == "body"]:
        if len(np.unique(table[name])) == len(table[name]):
            known[name] = Meaning()  # a name for each row
    open_ = [n for n, m in known.items() if not m.kind and table[n].dtype.kind in "fiu"]
    kinds = {means.kind for means in known.values()}
    first = next(iter(known))
    if not kinds & {"time", "frame"} and first in open_ and rising(table[first]):
        known[first] = Meaning("time", unit=known[first].unit)
        open_.remove(first)
    time = _first(known, "time")
    if "place" in kinds or not open_ or time is None:
        return known
    places: list[str] = []
    for name in open_:
        rate = any(is_rate_of(table[name], table[other], table[time]) for other in places)
        known[name] = Meaning("rate", unit=known[name].unit) if rate else known[name]
        places += [] if rate else [name]
    if len(places) == 1:
        unit = known[places[0]].unit
        known[places[0]] = Meaning("place", "angle" if unit in RADIANS else "q", unit=unit)
    return known


def _one_time(meanings: Mapping[str, Meaning], table: Table) -> dict[str, Meaning]:
    """Of several columns that are times by their names, those that do not rise are none.

    What stays for many rows numbers tracks instead, as MTrackJ's TID, which is Norwegian for time.
    """
    known = dict(meanings)
    times = [n for n, m in known.items() if m.kind == "time" and table[n].dtype.kind in "fiu"]
    rise = [name for name in times if rising(table[name])]
    for name in times if rise else []:
        if name not in rise:
            alone = _first(known, "body") is None and numbers_trials(table[name])
            known[name] = Meaning("body" if alone else "")
    return known


def _bodies(meanings: Mapping[str, Meaning]) -> tuple[tuple[str, ...], ...]:
    """Columns of each body: pixels (u, v), or places (x, y, z), or one coordinate."""
    places = {name: means for name, means in meanings.items() if means.kind == "place"}
    axes = {means.axis for means in places.values()}
    if axes & set(AXES):
        axes -= {"u", "v"}
    way = next((way for way in WAYS if axes & set(way)), ())
    wanted = tuple(axis for axis in way if axis in axes)
    by_body: dict[str, dict[str, str]] = {}
    for name, means in places.items():
        if means.axis in wanted:
            by_body.setdefault(means.body, {}).setdefault(means.axis, name)
    for number, columns in by_body.items():
        missing = [axis for axis in wanted if axis not in columns]
        if missing:
            raise InputError(
                f"body {number or 1}: columns {', '.join(columns.values())}, but no "
                f"{', '.join(missing)}; every body needs the same axes, or say which to take with "
                "`columns` x=NAME"
            )
    order = list(by_body)
    if all(not label or label.isdigit() for label in order):
        order = sorted(order, key=lambda label: int(label or 0))
    return tuple(tuple(by_body[n][axis] for axis in wanted) for n in order)


def numbers_of(table: Table, name: str) -> np.ndarray:
    """A column's numbers ``(rows,)``.

    Raises:
        InputError: another cell, which is named.
    """
    try:
        return np.asarray(table[name], float)
    except (TypeError, ValueError) as error:
        word = next(str(cell) for cell in table[name] if not _is_number(cell))
        raise InputError(f"column {name}: not numbers ('{word[:40]}')") from error


def _is_number(cell: object) -> bool:
    try:
        float(cell)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return False
    return True
