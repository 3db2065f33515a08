"""Lines as their author meant them: without quotes, brackets or a preamble; commas told apart."""

from __future__ import annotations

import re
from collections.abc import Sequence

QUOTED = re.compile(r'\s*"[^"]*"\s*')
OPENS = re.compile(r"\s*(?:\w+\s*=\s*)?\[[\s\[]*[-+.]?\d")
BEFORE = re.compile(r"^\s*(?:\w+\s*=\s*)?[\s\[]*")
BEHIND = " \t\r\n],;"
BEGIN, END = "$$SOE", "$$EOE"  # around the rows of JPL's Horizons, which names columns above them
RULE = re.compile(r"\*+")
DECIMAL = r"(?:[-+\N{MINUS SIGN}]?\d+,\d+(?:[eE][-+\N{MINUS SIGN}]?\d+)?)?"  # or nothing


def unwrapped(lines: Sequence[str]) -> list[str]:
    """The lines of a table as their author meant them.

    Where each line is one quoted cell, as a spreadsheet writes a text that it did not part, the
    quotes are taken off. Where rows are those of a matrix, ``[1 2;`` to ``3 4]``, brackets and
    semicolons are. Of an ephemeris its rows are kept, and the names above them.

    Example:
        >>> unwrapped(['"t;x"', '"0;1"']), unwrapped(["t x", "[0 1;", " 2 3]"])
        (['t;x', '0;1'], ['t x', '0 1', '2 3'])
    """
    if len(lines) > 1 and all(QUOTED.fullmatch(line) for line in lines):
        lines = [line.strip()[1:-1] for line in lines]
    lines = _ephemeris(lines)
    first = next((k for k, line in enumerate(lines) if OPENS.match(line)), None)
    if first is None:
        return list(lines)
    rows = [BEFORE.sub("", line).rstrip(BEHIND) for line in lines[first:]]
    return [*lines[:first], *(row for row in rows if row)]


def _ephemeris(lines: Sequence[str]) -> Sequence[str]:
    marks = [line.strip() for line in lines]
    if BEGIN not in marks:
        return lines
    begin, end = marks.index(BEGIN), marks.index(END) if END in marks else len(lines)
    names = [line for line in lines[:begin] if not RULE.fullmatch(line.strip())]
    return [line.rstrip(", ") for line in (*names[-1:], *lines[begin + 1 : end])]


def semicolons(lines: Sequence[str]) -> list[str]:
    """Lines with semicolons between numbers, where commas stand both between them and within.

    That is so where each row is as many numbers with a decimal comma, or empty cells, as there are
    names, and no other cells.

    Example:
        >>> semicolons(["t,x", "0,0,1,25", "0,1,,", "0,2,1,5"])
        ['t;x', '0,0;1,25', '0,1;', '0,2;1,5']
    """
    first = next((k for k, line in enumerate(lines) if re.match(r"\s*[-+]?\d", line)), 0)
    names = [] if first == 0 else lines[first - 1].rstrip(", ").split(",")
    row = re.compile(",".join([f"({DECIMAL})"] * len(names)) + r",?\s*")
    found = [row.fullmatch(line.strip()) for line in lines[first:]] if len(names) > 1 else [None]
    if not all(found):
        return list(lines)
    above = [line.replace(",", ";") for line in lines[:first]]
    return above + [";".join(each.groups()) for each in found if each is not None]
