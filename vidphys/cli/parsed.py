"""Options of a verb from the command line; what is wrong with them in one line, not in a box."""

from __future__ import annotations

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from typing import Any

import tyro

from vidphys.errors import InputError

DEEP = 4  # blanks before a line, from which on it is an option's help
RULE = "─-╰╯ "
KIND = re.compile(r"Error parsing (\S+): no type matching (\S+) could be instantiated from (.*)$")


def parsed(verb: str, config: type, arguments: Sequence[str]) -> Any:
    """The options of a verb.

    Raises:
        InputError: arguments that are none of its options, or no values of them.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            found: Any = tyro.cli(config, args=arguments, prog=f"vidphys {verb}")
    except SystemExit as end:
        if not end.code:
            raise
        raise InputError(
            f"{in_a_line(said.getvalue())}; `vidphys help {verb}` shows the options"
        ) from None
    sys.stderr.write(said.getvalue())
    return found


def in_a_line(box: str) -> str:
    """What tyro draws a box or rules around, without the options' help."""
    blocks: list[list[str]] = [[]]  # the title's first
    for line in box.splitlines():
        inner = line[2:].rstrip(" │")
        if line.startswith("╭") or (inner and not inner.strip(RULE)):
            blocks.append([])
        elif not inner.startswith(" " * (DEEP + 1)):
            blocks[-1].append(inner.strip())
    if len(blocks) == 1:
        return " ".join(box.split())
    first, *others = (" ".join(" ".join(lines).split()) for lines in blocks[1:])
    first = first.partition(" Got errors:")[0].rstrip(".")
    kind = KIND.match(first)
    if kind:
        first = f"{kind[1]} {kind[3].strip('[]')}: must be {kind[2].replace('{None}|', '')}"
    near = [text for text in others if text.startswith("Perhaps you meant")]
    return "; ".join([first, *(text[0].lower() + text[1:] for text in near)])
