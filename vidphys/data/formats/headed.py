"""Texts with a heading above each frame or body, as one table with a row for each body and time.

XYZ files and dumps of LAMMPS have a heading above each frame, old exports of Kinovea one above each
trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence

KINOVEA = "#Kinovea"
ITEM = "ITEM:"  # begins each heading of a dump
UNFOLDED = ("xu", "yu", "zu")  # places that do not jump where a box ends


def beneath(lines: Sequence[str]) -> list[str]:
    """The rows below headings, with what these say in each; other lines as they are.

    Args:
        lines: of a text, none of them empty.

    Example:
        >>> beneath(["1", "first", "Ar 0 0 1", "1", "second", "Ar 0 0 2"])
        ['frame body x y z', '0 1 0 0 1', '1 1 0 0 2']
    """
    if lines and lines[0].startswith(KINOVEA):
        return _trajectories(lines)
    if lines and lines[0].startswith(ITEM):
        return _dumped(lines)
    return _atoms(lines) or list(lines)


def _trajectories(lines: Sequence[str]) -> list[str]:
    """Of Kinovea: ``# name`` above the times and places of each body."""
    whom, rows = "", ["t x y body"]
    for line in lines[1:]:
        if line.startswith("#"):
            whom = line[1:].strip().replace(" ", "_")
        else:
            rows.append(f"{line.strip()} {whom}")
    return rows


def _atoms(lines: Sequence[str]) -> list[str] | None:
    """Of XYZ: their number, a comment, then a symbol and a place for each; ``None`` of others."""
    rows, at, frame = ["frame body x y z"], 0, 0
    while at < len(lines):
        count = lines[at].strip()
        if not count.isdigit() or int(count) == 0 or at + 2 + int(count) > len(lines):
            return None
        for body, line in enumerate(lines[at + 2 : at + 2 + int(count)], 1):
            cells = line.split()
            if len(cells) < 4 or cells[0][:1].isdigit():
                return None
            rows.append(f"{frame} {body} {' '.join(cells[1:4])}")
        at, frame = at + 2 + int(count), frame + 1
    return rows if frame > 1 else None


def _dumped(lines: Sequence[str]) -> list[str]:
    """Of LAMMPS: the number of a step, and columns under their names, among them x or xu."""
    names: list[str] = []
    heading, step, rows = "", "0", []
    for line in lines:
        if line.startswith(ITEM):
            heading = line[len(ITEM) :].strip()
            names = heading.split()[1:] if heading.startswith("ATOMS") else names
        elif heading == "TIMESTEP":
            step = line.strip()
        elif heading.startswith("ATOMS"):
            rows.append(f"{step} {line.strip()}")
    plain = [name.removesuffix("u") if name in UNFOLDED else name for name in names]
    return [" ".join(["frame", *plain]), *rows]
