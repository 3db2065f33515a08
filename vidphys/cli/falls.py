"""What no verb foresaw, as one line: what it was, where its traceback lies, what to report."""

from __future__ import annotations

import importlib.metadata
import os
import re
import select
import sys
import tempfile
import traceback

FAILED, UNREAD = 1, 141
SYSTEM = re.compile(r"\(os error (\d+)\)")  # as safetensors says it
UNLIKE = "operator torchvision::"  # does not exist, where its library could not be loaded
GOES_ON = "; what is finished is kept: the same command goes on from here"


def fallen(verb: str, error: Exception) -> int:
    """Say an exception that nothing caught, in one line; returns the exit code.

    A disk that is full or cannot be written is told as such. Anything else is a mistake of ours.
    """
    if isinstance(error, BrokenPipeError) and _is_unread():
        return UNREAD
    if isinstance(error, MemoryError):
        return _say(
            f"vidphys {verb}: memory ran out ({_one_line(error)}); take less at once{GOES_ON}"
        )
    if str(error).startswith(UNLIKE):
        here = (f"{name} {importlib.metadata.version(name)}" for name in ("torch", "torchvision"))
        return _say(
            f"vidphys {verb}: {' and '.join(here)} are of different builds, such as one for a card "
            "and one for the CPU; install both anew from the same index"
        )
    error = _of_the_system(error)
    if isinstance(error, OSError) and error.strerror and error.errno is not None:
        where = "" if error.filename is None else f"{os.fsdecode(error.filename)!s}: "
        return _say(f"vidphys {verb}: {where}{error.strerror}{GOES_ON}{_kept(error)}")
    return _say(
        f"vidphys {verb}: {type(error).__name__}: {_one_line(error)}; this is a mistake of vidphys"
        f"{_kept(error)}; report it with that, the command and what `vidphys doctor` says"
    )


def _of_the_system(error: Exception) -> Exception:
    """What a library says of the system in its own exceptions, as Python's own."""
    found = SYSTEM.search(str(error))
    if isinstance(error, OSError) or found is None:
        return error
    told = OSError(int(found[1]), os.strerror(int(found[1])))
    return told.with_traceback(error.__traceback__)


def _say(text: str) -> int:
    sys.stderr.write(f"error: {text}\n")
    return FAILED


def _is_unread() -> bool:
    """Whether standard output is what broke; it is then led to nowhere, for the last flush."""
    try:
        output = sys.stdout.fileno()
    except (OSError, ValueError):
        return False
    poll = select.poll()
    poll.register(output, 0)
    if not any(event & select.POLLERR for _, event in poll.poll(0)):
        return False
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return True


def _kept(error: Exception) -> str:
    """Write the traceback into a file of its own; says where, or in which line it was."""
    text = "".join(traceback.format_exception(error))
    try:
        number, path = tempfile.mkstemp(prefix="vidphys-", suffix=".txt")
        with os.fdopen(number, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"; it was raised in {last.filename}, line {last.lineno}"
    return f"; the traceback is in {path}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
