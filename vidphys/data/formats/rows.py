"""From the columns of a table to the recording that they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from vidphys.data.formats.base import Recording, Unit
from vidphys.data.formats.bounded import require_room
from vidphys.data.formats.boxes import centred
from vidphys.data.formats.clock import Clock, clock_of
from vidphys.data.formats.columns import Columns, Table, detect_columns, numbers_of, shown
from vidphys.data.formats.names import LENGTHS, PIXELS, RADIANS, meaning_of
from vidphys.data.formats.placeholders import unseen
from vidphys.data.formats.stamps import cleaned, restarts, unrounded
from vidphys.errors import InputError

TURNS = 4 * np.pi


def recording_of(
    table: Table,
    given: Mapping[str, str],
    interval: float | None,
    notes: tuple[str, ...] = (),
    called: str = "",
) -> Recording:
    """The recording that a table is.

    Args:
        table: columns of numbers or words, ``(rows,)``, by name.
        given, interval: see :class:`vidphys.data.formats.TrackFormat`.
        notes: how the table was read.
        called: the name of its file, which may say that it is of a pendulum.

    Raises:
        InputError: columns that cannot be told, or that hold no numbers.
    """
    table, boxes = (table, ()) if given else centred(table)
    notes = (*notes, *boxes)
    columns = detect_columns(list(table), given, table)
    if columns.alone and "pendul" in called.lower() and _turns(table, columns):
        columns = replace(columns, angles=True)
        notes = (*notes, "an angle, as the file is called after a pendulum")
    columns, left_out = shown(columns, table)
    clock = clock_of(table, columns, interval if interval is not None and interval > 0 else None)
    order = clock.values
    clip, trials = _clips(table, columns, order)
    places, length = _places(table, columns)
    said: list[str] = []
    if columns.body is not None:
        labels = table[columns.body]
        names = np.unique(labels)
        parts = [_long(order, places[:, 0], labels, names, clip == c) for c in np.unique(clip)]
    else:
        names = np.arange(places.shape[1])
        parts = [_sorted(order[clip == c], places[clip == c]) for c in np.unique(clip)]
        done = [cleaned(*part) for part in parts]
        parts = [(times, q) for times, q, _ in done if len(times)]
        said = list(dict.fromkeys(line for *_, lines in done for line in lines))
    if not columns.angles:
        bare = [unseen(q) for _, q in parts]
        parts = [(times, q) for (times, _), (q, _) in zip(parts, bare, strict=True)]
        said += dict.fromkeys(line for _, lines in bare for line in lines)
    times, positions = _padded(parts)
    even, rounded = _even(parts) if clock.seconds else (None, ())
    kind: Unit = "angles" if columns.angles else "pixels" if columns.pixels else "world"
    taken = _taken(columns, clock, kind, length, names)
    counted = columns.frame if columns.time is None and interval is None else None
    return Recording(
        positions,
        even,
        kind,
        _of_bodies(table, columns, names, len(parts)),
        _of_clips(table, columns.coupling, clip),
        ("; ".join([*notes, *taken, *left_out, *trials, *said, *rounded]),),
        length,
        _inputs(table, columns, order, clip, times),
        columns.inputs,
        times[0] if counted is not None and len(times) == 1 else None,
    )


def columns_of(
    table: Table, given: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
    """All columns of the table of one clip, a row for each time.

    Where each body has rows of its own, what differs between them is told apart by numbers, in the
    order of their names: ``heat1``, ``heat2``.

    Args:
        table: columns of numbers or words, ``(rows,)``, by name.
        given: what some columns are; see :class:`vidphys.data.formats.TrackFormat`.

    Returns:
        The columns, ``(t,)`` each, NaN or ``None`` where a body has no row; and the number of each
        row's frame ``(t,)``, where the table says it.

    Raises:
        InputError: columns of several clips, or frames that are no numbers.
    """
    told = {name: role for role, name in given.items()}
    roles: dict[str, str] = {}
    for name in table:
        roles.setdefault(meaning_of(told.get(name, name)).kind, name)
    clip, by = roles.get("clip"), roles.get("time", roles.get("frame"))
    if clip is not None and len(np.unique(table[clip])) > 1:
        raise InputError(f"{len(np.unique(table[clip]))} clips by {clip}; give a table for each")
    if by is None:
        return dict(table), None
    moments, at = np.unique(table[by], return_inverse=True)
    body, held = roles.get("body"), dict(table)
    if body is not None and len(moments) < len(at):
        held = _side_by_side(table, body, at, len(moments))
    elif len(moments) == len(at):
        held = {name: values[np.argsort(at)] for name, values in table.items()}
    return held, None if "time" in roles else numbers_of(held, by)


def _side_by_side(table: Table, body: str, at: np.ndarray, times: int) -> dict[str, np.ndarray]:
    """Columns whose rows are of a body each, a row for each time."""
    names, whose = np.unique(table[body], return_inverse=True)
    require_room((times, len(names), len(table)), 8, "frames by bodies")
    held: dict[str, np.ndarray] = {}
    for name, values in table.items():
        empty = np.nan if values.dtype.kind in "fiub" else None
        kind = float if values.dtype.kind in "fiub" else object
        parts = np.full((times, len(names)), empty, dtype=kind)
        parts[at, whose] = values
        common = np.full(times, empty, dtype=kind)
        common[at] = values
        if np.array_equal(common[at], values.astype(kind), equal_nan=kind is float):
            held[name] = common
        else:
            held |= {f"{name}{k + 1}": parts[:, k] for k in range(len(names))}
    return held


def _inputs(
    table: Table, columns: Columns, order: np.ndarray, clip: np.ndarray, times: np.ndarray
) -> np.ndarray | None:
    """Known inputs at the frames of each clip, ``(e, t, m)``."""
    if not columns.inputs or columns.body is not None:
        return None
    values = np.stack([numbers_of(table, name) for name in columns.inputs], -1)
    out = np.empty((*times.shape, values.shape[1]))
    whole = [number for number in np.unique(clip) if np.isfinite(order[clip == number]).any()]
    for row, number in enumerate(whole):
        for column in range(values.shape[1]):
            known = (clip == number) & np.isfinite(order) & np.isfinite(values[:, column])
            when, first = np.unique(order[known], return_index=True)
            at = values[known, column][first]
            out[row, :, column] = np.interp(times[row], when, at) if len(when) else 0.0
    return out


def _turns(table: Table, columns: Columns) -> bool:
    """Whether coordinates without a unit of length stay within two turns to either side."""
    names = [name for body in columns.coordinates for name in body]
    if any(columns.units.get(name) for name in names):
        return False
    return all(np.nanmax(np.abs(numbers_of(table, name))) < TURNS for name in names)


def _taken(columns: Columns, clock: Clock, kind: Unit, length: str, names: np.ndarray) -> list[str]:
    """What was taken for what, in words."""
    what = {"angles": "angles", "pixels": "pixels, y counted downwards:", "world": "coordinates"}
    read = ", ".join("/".join(body) for body in columns.coordinates)
    unit = f" in {length}" if length and kind != "pixels" else ""
    told = [f"{what[kind]} {read}{unit}", f"time {clock.said}"]
    if columns.body is not None:
        told.append(f"{len(names)} {'body' if len(names) == 1 else 'bodies'} by {columns.body}")
    if columns.rates:
        told.append(f"rates, not taken: {', '.join(columns.rates)}")
    if columns.inputs:
        told.append(f"known inputs: {', '.join(columns.inputs)}")
    if columns.others:
        told.append(f"not taken: {', '.join(columns.others)}")
    return told


def _clips(table: Table, columns: Columns, order: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Number of the clip of each row, and how clips were told."""
    if columns.clip is not None:
        found = np.unique(table[columns.clip], return_inverse=True)[1]
        count = found.max() + 1
        return found, (f"{count} clips by {columns.clip}",) if count > 1 else ()
    trials = restarts(order) if columns.body is None else None
    if trials is None:
        return np.zeros(len(order), int), ()
    return trials, (f"times begin anew, so {trials.max() + 1} clips",)


def _places(table: Table, columns: Columns) -> tuple[np.ndarray, str]:
    """Coordinates ``(rows, bodies, axes)`` in one unit, and that unit: radians for angles."""
    names = [name for body in columns.coordinates for name in body]
    units = {name: columns.units.get(name, "") for name in names}
    lengths = [unit for unit in units.values() if unit in LENGTHS]
    shown = lengths[0] if lengths else "px" if any(u in PIXELS for u in units.values()) else ""

    def one(name: str) -> np.ndarray:
        values, unit = numbers_of(table, name), units[name]
        if columns.angles:
            return values * RADIANS.get(unit, 1.0)
        return values * (LENGTHS[unit] / LENGTHS[shown]) if unit in LENGTHS else values

    places = np.stack([np.stack([one(c) for c in body], -1) for body in columns.coordinates], 1)
    places = np.where(np.isfinite(places), places, np.nan)
    if not np.isfinite(places).any():
        raise InputError(f"columns {', '.join(names)}: not numbers (every cell is empty or a word)")
    return places, "rad" if columns.angles else "px" if columns.pixels else shown


def _sorted(times: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(times, kind="stable")
    return times[order], places[order]


def _long(
    times: np.ndarray, places: np.ndarray, labels: np.ndarray, names: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A body in each row: one frame for each time, NaN where a body has none."""
    frames, at = np.unique(times[rows], return_inverse=True)
    body = np.searchsorted(names, labels[rows])
    require_room((len(frames), len(names), places.shape[-1]), 8, "frames by bodies")
    out = np.full((len(frames), len(names), places.shape[-1]), np.nan)
    if len(np.unique(at * len(names) + body)) < len(at):
        raise InputError("a body has two rows at one time; a column may tell clips apart")
    out[at, body] = places[rows]
    return frames, out


def _padded(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Clips of one length: shorter ones end in frames in which nothing was seen."""
    if not parts:
        raise InputError("no row has a time")
    longest = max(len(times) for times, _ in parts)
    require_room((len(parts), longest, *parts[0][1].shape[1:]), 8, "clips by frames")
    steps = np.concatenate([np.diff(times) for times, _ in parts])
    usual = float(np.median(steps)) if len(steps) else 0.0
    times, places = [], []
    for t, q in parts:
        rest = longest - len(t)
        times.append(np.concatenate([t, t[-1] + usual * np.arange(1, rest + 1)]))
        places.append(np.concatenate([q, np.full((rest, *q.shape[1:]), np.nan)]))
    return np.stack(times), np.stack(places)


def _even(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Times of clips of one length, without what few digits made of them; and that it was so."""
    found = [unrounded(times) for times, _ in parts]
    even = [(times, q) for (times, _), (_, q) in zip(found, parts, strict=True)]
    quantum = max(quantum for _, quantum in found)
    said = (f"times rounded to {quantum:g} s, spread evenly",) if quantum else ()
    return _padded(even)[0], said


def _of_bodies(table: Table, columns: Columns, names: np.ndarray, clips: int) -> np.ndarray | None:
    """Masses, one for each body, where the table has them.

    What changes from row to row, as the brightness that trackers call so, is none.
    """
    if columns.mass is None or columns.body is None:
        return None
    mass, labels = numbers_of(table, columns.mass), table[columns.body]
    if any(len(np.unique(mass[labels == name])) > 1 for name in names):
        return None
    return np.tile(np.array([np.median(mass[labels == name]) for name in names]), (clips, 1))


def _of_clips(table: Table, name: str | None, clip: np.ndarray) -> np.ndarray | None:
    if name is None:
        return None
    values = numbers_of(table, name)
    return np.array([np.median(values[clip == c]) for c in np.unique(clip)])
