"""Texts of motion capture systems: lines above the numbers say the rate, the unit and the markers.

They are OpenSim's ``.trc``, Qualisys' ``.tsv``, and the ``.csv`` of OptiTrack's Motive and of
Vicon's Nexus. Each marker has three columns; an empty cell says that it was not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vidphys.data.formats.base import Recording
from vidphys.data.formats.bounded import require_room
from vidphys.data.formats.names import LENGTHS
from vidphys.data.formats.text import decoded, number
from vidphys.errors import InputError

SPACE = 3  # coordinates of a marker
WORDS = {"millimeters": "mm", "centimeters": "cm", "meters": "m", "inches": "in", "feet": "ft"}
Lines = list[list[str]]


@dataclass(frozen=True)
class _Take:
    """What a file says.

    Args:
        rate: frames a second.
        unit: of places, as :data:`LENGTHS` has it, or empty.
        markers: names.
        first: column of each marker's first coordinate.
        rows: of numbers, from the first frame on.
    """

    rate: float
    unit: str
    markers: Sequence[str]
    first: Sequence[int]
    rows: Lines


def is_captured(path: Path) -> bool:
    """Whether a text begins as such a file does."""
    with path.open("rb") as file:
        begins = file.read(64).decode("latin-1").lstrip("ï»¿ \t\"'")
    return begins.startswith(tuple(KINDS))


def read_captured(path: Path, columns: Mapping[str, str], _interval: float | None) -> Recording:
    """The markers of a file, each a body; its own rate tells the times.

    Raises:
        InputError: a file that ends early, or a marker that it does not have.
    """
    text = decoded(path).lstrip("\ufeff")
    kind = next(name for name in KINDS if text.lstrip(" \t\"'").startswith(name))
    lines = [
        [cell.strip(' "') for cell in line.split("\t" if "\t" in text else ",")]
        for line in text.splitlines()
    ]
    try:
        take = KINDS[kind](lines)
    except InputError:
        raise
    except (ValueError, LookupError, StopIteration) as error:
        raise InputError(
            f"begins as a motion capture file ({kind}), but goes on otherwise"
        ) from error
    names = wanted(take.markers, columns)
    places = _places(take, names)
    return of_markers(places, [take.markers[n] for n in names], take.rate, take.unit)


def _opensim(lines: Lines) -> _Take:
    told = dict(zip(lines[1], lines[2], strict=False))
    at = [k for k, name in enumerate(lines[3]) if name and k > 1]
    return _Take(float(told["DataRate"]), told["Units"], [lines[3][k] for k in at], at, lines[5:])


def _qualisys(lines: Lines) -> _Take:
    told = {line[0]: line[1:] for line in lines if line[0].isupper()}
    names = [name for name in told["MARKER_NAMES"] if name]
    rows = lines[max(k for k, line in enumerate(lines) if line[0].isupper()) + 1 :]
    headed = rows[0][0] == "Frame"  # then frames and times come first
    at = [2 * headed + SPACE * k for k in range(len(names))]
    rows = [_without_origin(row, at) for row in rows[headed:]]
    return _Take(float(told["FREQUENCY"][0]), "mm", names, at, rows)


def _without_origin(row: list[str], at: Sequence[int]) -> list[str]:
    """A row without the markers at (0, 0, 0): so Qualisys says that one was not seen."""
    out = list(row)
    for k in at:
        place = [_number(cell) for cell in row[k : k + SPACE]]
        if place == [0.0] * SPACE:
            out[k : k + SPACE] = [""] * SPACE
    return out


def _motive(lines: Lines) -> _Take:
    told = dict(zip(lines[0][::2], lines[0][1::2], strict=False))
    head = next(k for k, line in enumerate(lines) if line[0].startswith("Frame"))
    labels = [line for line in lines[1:head] if any(line)]
    names, kinds = labels[1], labels[-1]
    at = [k for k in range(2, len(kinds)) if kinds[k] == "Position" and lines[head][k] == "X"]
    rate = float(told.get("Export Frame Rate") or told["Capture Frame Rate"])
    unit = told.get("Length Units", "")
    return _Take(rate, unit, [names[k] for k in at], at, lines[head + 1 :])


def _vicon(lines: Lines) -> _Take:
    names, units = lines[2], lines[4]
    at = [k for k, name in enumerate(names) if name and k > 1]
    end = next((k for k, line in enumerate(lines) if k > 4 and not any(line)), len(lines))
    return _Take(float(lines[1][0]), units[at[0]], [names[k] for k in at], at, lines[5:end])


KINDS: Mapping[str, Callable[[Lines], _Take]] = {
    "PathFileType": _opensim,
    "NO_OF_FRAMES": _qualisys,
    "FILE_VERSION": _qualisys,
    "Format Version": _motive,
    "Trajectories": _vicon,
}


def wanted(markers: Sequence[str], columns: Mapping[str, str]) -> list[int]:
    """Which markers are taken: all, or those that are said.

    Raises:
        InputError: what is said is no marker.
    """
    if not columns:
        return list(range(len(markers)))
    names = [name.strip() for name in columns.get("body", "").split(",")]
    if set(columns) != {"body"} or not set(names) <= set(markers):
        raise InputError(
            f"`columns`: the markers are {', '.join(markers)}; take some with `columns` "
            "body=NAME,NAME"
        )
    return [list(markers).index(name) for name in names]


def _places(take: _Take, wanted: Sequence[int]) -> np.ndarray:
    rows = [row for row in take.rows if any(row)]
    require_room((len(rows), max(len(wanted), 1), SPACE), 8, "frames by markers")
    places = np.full((len(rows), len(wanted), SPACE), np.nan)
    for k, row in enumerate(rows):
        for n, marker in enumerate(wanted):
            cells = row[take.first[marker] : take.first[marker] + SPACE]
            places[k, n, : len(cells)] = [_number(cell) for cell in cells]
    return places


def of_markers(places: np.ndarray, names: Sequence[str], rate: float, unit: str) -> Recording:
    """A recording of those markers that are seen in some frame.

    Args:
        places: ``(t, n, 3)``; NaN where one was not seen.
        names: of the markers.
        rate: frames a second.
        unit: of places, as the system calls it; it may be empty.

    Raises:
        InputError: none is seen, or the rate is no rate.
    """
    seen = np.isfinite(places).all(-1).any(0)
    if not seen.any() or not rate > 0:
        raise InputError("no marker is seen in any frame, or no rate is told")
    unit = WORDS.get(unit.lower(), unit.lower())
    names = [name for name, shown in zip(names, seen, strict=True) if shown]
    note = f"{len(names)} marker{'s' * (len(names) > 1)} of motion capture: {', '.join(names)}"
    return Recording(
        places[None, :, seen],
        (np.arange(len(places)) / rate)[None],
        notes=(f"{note}; {rate:g} frames a second",),
        length=unit if unit in LENGTHS else "",
    )


def _number(cell: str) -> float:
    found = number(cell)
    if found is None:
        raise InputError(f"'{cell[:20]}' among the places of markers is no number")
    return found
