"""What a report says in its first three sentences: what was asked, what holds, what does not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viz.roles import named
from viz.summary import SKILL_BAR, TWIN, Line, Records
from viz.tables import FAILS, HOLDS, NO_VERDICT, verdict

MOST = 4  # names that a sentence holds


def law(coupling: float | None) -> str:
    """A law in words."""
    return "another law" if coupling is None else f"G = {_signed(coupling)}"


def _signed(value: float) -> str:
    return f"{value:g}".replace("-", "−")


def asked(records: Records, about: Mapping[str, Any]) -> str:
    """Of what, and how much."""
    cells, wanted = _cells(records, about)
    # A head that was trained with its perception is a row of its cell, and no cell of its own.
    cells = cells & wanted or cells
    rungs = {cell.partition("/")[0] for cell in cells}
    of = f" of {len(wanted)}" if len(wanted) > len(cells) else ""
    seeds = named(records)
    return (
        f"Models that saw G > 0 only were asked how the bodies move under {law(records.coupling)}: "
        f"{len(cells)}{of} cells on {_count(len(rungs), 'rung')}, "
        f"{_noun(seeds, 'seed')} {seeds}."
    )


def holds(records: Records) -> str:
    """How many claims hold; a row is a head under one way to read momentum."""
    told = verdicts(records)
    good = [line for line, word, _ in told if word == HOLDS]
    twins = [line for line in records.lines if line.head == TWIN]
    inverting = sum(_inverts(records, line) for line in twins)
    rows = f"{len(good)} of {_count(len(told), 'row')} of factored heads"
    rivals = f"; {inverting} of {_count(len(twins), 'row')} of twins answer" if twins else ""
    return f"{rows} answer, with the twin worse on every seed{rivals}."


def fails(records: Records, about: Mapping[str, Any]) -> str:
    """What does not hold, has no verdict, and was not run."""
    told = verdicts(records)
    parts = []
    for word, lead in ((FAILS, "Does not hold"), (NO_VERDICT, "no verdict")):
        if names := [_name(line) for line, found, _ in told if found == word]:
            parts.append(f"{lead}: {_listed(names)}")
    skipped = [str(entry.get("cell", "")) for entry in about.get("skipped") or []]
    if skipped:
        rungs = [name.removeprefix("ladder/").partition("/")[0] for name in skipped]
        parts.append(f"not run: {_listed(rungs)}")
    cells, wanted = _cells(records, about)
    left = len(wanted - cells) - len(skipped)
    if left > 0:
        parts.append(f"not run yet: {_count(left, 'cell')}")
    if not parts:
        return "Nothing that was asked failed, and nothing was left out."
    text = "; ".join(parts) + "."
    return text[0].upper() + text[1:]


def _cells(records: Records, about: Mapping[str, Any]) -> tuple[set[str], set[str]]:
    """The cells that have records, and those that were asked for."""
    cells = {f"{line.grounding}/{line.head}" for line in records.lines}
    wanted = {key.partition("/")[2] for key in (about.get("settings") or {}).get("asked") or {}}
    return cells, wanted


def verdicts(records: Records) -> list[tuple[Line, str, str]]:
    """Each factored head's (line, verdict, why)."""
    found = []
    for lines in records.rungs.values():
        twin = next((line for line in lines if line.head == TWIN), None)
        for line in lines:
            if line.head.startswith("factored"):
                found.append((line, *verdict(records, line, twin)))
    return found


def _inverts(records: Records, line: Line) -> bool:
    skill = records.pick(line, "ballistic_skill", coupling=records.coupling)
    return bool(skill and skill.values and not skill.bad and max(skill.values) < SKILL_BAR)


def _name(line: Line) -> str:
    return line.rung if line.head == "factored" else f"{line.rung} {line.head}"


def _listed(names: Sequence[str]) -> str:
    each = list(dict.fromkeys(names))
    more = f" and {len(each) - MOST} more" if len(each) > MOST else ""
    return ", ".join(each[:MOST]) + more


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _noun(listed: str, noun: str) -> str:
    return noun + ("s" if "," in listed or ";" in listed else "")
