"""Lines without what a program put around them: quotes of whole lines, brackets of a matrix."""

from __future__ import annotations

import re
from collections.abc import Sequence

QUOTED = re.compile(r'\s*"[^"]*"\s*')
OPENS = re.compile(r"\s*(?:\w+\s*=\s*)?\[[\s\[]*[-+.]?\d")
BEFORE = re.compile(r"^\s*(?:\w+\s*=\s*)?[\s\[]*")
BEHIND = " \t\r\n],;"


def unwrapped(lines: Sequence[str]) -> list[str]:
    """The lines of a table as their author meant them.

    Where each line is one quoted cell, as a spreadsheet writes a text that it did not part, the
    quotes are taken off. Where rows are those of a matrix, ``[1 2;`` to ``3 4]``, brackets and
    semicolons are.

    Example:
        >>> unwrapped(['"t;x"', '"0;1"']), unwrapped(["t x", "[0 1;", " 2 3]"])
        (['t;x', '0;1'], ['t x', '0 1', '2 3'])
    """
    if len(lines) > 1 and all(QUOTED.fullmatch(line) for line in lines):
        lines = [line.strip()[1:-1] for line in lines]
    first = next((k for k, line in enumerate(lines) if OPENS.match(line)), None)
    if first is None:
        return list(lines)
    rows = [BEFORE.sub("", line).rstrip(BEHIND) for line in lines[first:]]
    return [*lines[:first], *(row for row in rows if row)]
