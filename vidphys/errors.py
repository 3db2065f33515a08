"""The one exception that the command line turns into a single line and exit code 2."""

from __future__ import annotations


class InputError(ValueError):
    """The user's input is wrong: says what, where, and what to do, in one line."""
