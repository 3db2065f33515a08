"""What a program in this folder may do, and how it answers."""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
from typing import Any

FILE = "/dev/fd/0"
FILES = 4  # open at once: the three that it has, and the file by its name; so no socket either
LENGTH = struct.Struct("<Q")  # bytes of a message
HEAD = struct.Struct("<dII")  # of a frame: seconds, height, width; no rows: the end


def confine(memory: int) -> None:
    """From here on: so much memory, one more open file, none written, no core left behind.

    Args:
        memory: bytes that may be asked for, on top of those of the libraries.
    """
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a start counts
            held = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + memory, held + memory))
    for what, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, FILES),
    ):
        resource.setrlimit(what, (most, most))


def allow(seconds: int) -> None:
    """So much more processor time."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    until = int(used.ru_utime + used.ru_stime) + 1 + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (until, resource.RLIM_INFINITY))


def say(words: dict[str, Any]) -> None:
    """Send a message: :data:`LENGTH`, then JSON; one with ``error`` is the last."""
    data = json.dumps(words).encode()
    write(LENGTH.pack(len(data)))
    write(data)


def write(data: Any) -> None:
    """Send bytes."""
    rest = memoryview(data).cast("B")
    while rest:
        rest = rest[os.write(1, rest) :]
