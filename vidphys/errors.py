"""The one exception that the command line turns into a single line and exit code 2.

A message has the names of arguments in backquotes; where a verb has an option of that name, the
command line says the option instead.
"""

from __future__ import annotations


class InputError(ValueError):
    """The user's input is wrong: says what, where, and what to do, in one line."""


def is_utf8(name: str) -> bool:
    """Whether the name of a file can be told to libraries; some names are only bytes."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True
