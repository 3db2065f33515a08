"""Names for columns that their table does not name, by where they stand and by their numbers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from vidphys.data.formats.boxes import MOT, is_mot
from vidphys.data.formats.names import meaning_of
from vidphys.data.formats.shapes import is_rate_of, numbers_trials, rising
from vidphys.errors import InputError

AXES = "xyz"


def named(
    names: Sequence[str], labels: Sequence[str], columns: Sequence[np.ndarray]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """A table with a name for each column.

    Args:
        names: of some of the columns, or none.
        labels: whom columns are of, as many as names; empty where nothing says it.
        columns: ``(rows,)`` each.

    Returns:
        The table, and what was added, a line each.

    Raises:
        InputError: more columns than names, and nothing tells which are named.
    """
    if not names:
        return _guessed(columns)
    before = _before(names, columns)
    after = len(columns) - len(before) - len(names)
    if after < 0:
        before, after = [], len(columns) - len(names)
    notes = []
    if before:
        notes.append(f"{', '.join(before)} before the columns that are named")
    if after > 0:
        notes.append(f"{after} columns after them left out")
    every = [*before, *_apart(names, labels)]
    return dict(zip(every, columns, strict=False)), tuple(notes)


def _apart(names: Sequence[str], labels: Sequence[str]) -> list[str]:
    """Names that differ: those that come again are told apart by their label, or by a number."""
    times: dict[str, int] = {}
    out: list[str] = []
    for name, label in zip(names, labels or [""] * len(names), strict=True):
        times[name] = times.get(name, 0) + 1
        told = name or f"column {len(out) + 1}"
        if list(names).count(name) > 1 and not (meaning_of(name).kind == "time" and not out):
            whom = [f"{label} {told}" if label else "", f"{times[name]} {told}"]
            numbered = (f"{number} {told}" for number in itertools.count(len(out) + 1))
            told = next(t for t in itertools.chain(whom, numbered) if t and t not in out)
        out.append(told)
    return out


def _before(names: Sequence[str], columns: Sequence[np.ndarray]) -> list[str]:
    """Columns that stand unnamed before the first that is named: a trial, a time."""
    if len(columns) == len(names):
        return []
    if any(meaning_of(name).kind in ("time", "frame") for name in names):
        return []
    found = []
    rest = list(columns)
    if len(rest) > len(names) + 1 and numbers_trials(rest[0]) and rising(rest[1]):
        found.append("trial")
        rest = rest[1:]
    if rising(rest[0]):
        return [*found, "t"]
    raise InputError(
        f"{len(columns)} columns, but {len(names)} names: {', '.join(names)}; name each column"
    )


def _guessed(columns: Sequence[np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Names for a table of numbers alone: a trial or a frame, a time, then places without rates."""
    rest = list(columns)
    if is_mot(rest):
        return dict(zip(MOT, columns, strict=False)), ("boxes of tracks, as MOTChallenge has them",)
    heads: list[str] = []
    if len(rest) > 2 and rising(rest[1]):
        whole = bool((np.asarray(rest[0]) == np.round(rest[0])).all())
        if numbers_trials(rest[0]):
            heads = ["trial", "t"]
        elif whole and rising(rest[0]):
            heads = ["frame", "t"]
    if not heads and len(rest) > 1 and rising(rest[0]):
        heads = ["t"]
    rest = rest[len(heads) :]
    places: list[np.ndarray] = []
    kinds: list[bool] = []
    time = columns[len(heads) - 1] if heads else np.arange(len(rest[0]), dtype=float)
    for column in rest:
        rate = bool(heads) and any(is_rate_of(column, place, time) for place in places)
        kinds.append(rate)
        places += [] if rate else [column]
    count = kinds.count(False)
    space = 1 if count == 1 else 3 if count == 3 else 2 if count % 2 == 0 else 1
    names, number, rates = [], 0, 0
    for rate in kinds:
        if rate:
            rates += 1
            names.append(f"rate {rates}")
            continue
        body = "" if count == space else str(number // space + 1)
        names.append(f"{AXES[number % space]}{body}")
        number += 1
    told = f"no names; taken for {', '.join([*heads, *names])}"
    climbing = [] if heads else [n for n, c in zip(names, rest, strict=True) if rising(c)]
    if len(climbing) == 1:
        told += f" ({climbing[0]} rises as times do)"
    return dict(zip([*heads, *names], columns, strict=True)), (told,)
