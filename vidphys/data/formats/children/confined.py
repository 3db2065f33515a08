"""What a program in this folder may do, and how it answers."""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

FILE = "/dev/fd/0"
FILES = 4  # open at once: the three that it has, and the file by its name; so no socket either
LENGTH = struct.Struct("<Q")  # bytes of a message
HEAD = struct.Struct("<dII")  # of a frame: seconds, height, width; no rows: the end
BYTES = 8  # of a number as it is held


class RefusedError(Exception):
    """A file that is understood, and not taken."""


@contextmanager
def refusing(what: str, memory: int) -> Iterator[None]:
    """Whatever a library says of a file that it cannot read, as a message, which is the last.

    Args:
        what: the file should have been, with its article.
        memory: see :func:`confine`.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except RefusedError as error:
        say({"error": str(error)})
    except MemoryError:
        say({"error": f"reading it takes more than {memory / 2**30:.3g} GiB of memory"})
    except Exception as error:
        said = str(error).strip().splitlines()[:1] or [type(error).__name__]
        say({"error": f"not {what} ({said[0][:200]})"})


def require_room(shape: Sequence[int], most_bytes: int, what: str) -> None:
    """Refuse what is too large to be a recording.

    Args:
        shape: of an array of numbers.
        most_bytes: of them.
        what: it is.

    Raises:
        RefusedError: it would fill more.
    """
    if np.prod(np.array(shape, float)) * BYTES > most_bytes:
        raise RefusedError(
            f"{what} of {' x '.join(map(str, shape))} numbers would fill more than "
            f"{most_bytes >> 20} MiB; give fewer of them"
        )


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


def send(arrays: Mapping[str, np.ndarray], **more: Any) -> None:
    """Send a message of the name, type and shape of each array, and more, then their bytes."""
    say({"arrays": [(name, x.dtype.str, x.shape) for name, x in arrays.items()], **more})
    for x in arrays.values():
        if x.size:
            write(np.ascontiguousarray(x).view(np.uint8))


def write(data: Any) -> None:
    """Send bytes."""
    rest = memoryview(data).cast("B")
    while rest:
        rest = rest[os.write(1, rest) :]
