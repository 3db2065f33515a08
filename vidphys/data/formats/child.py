"""A process that reads a file for us, held to limits, so that a hurt file cannot hurt us."""

from __future__ import annotations

import fcntl
import importlib.util
import json
import os
import select
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from vidphys.data.formats import children
from vidphys.data.formats.children.confined import LENGTH
from vidphys.errors import InputError

PATIENCE = 60.0  # seconds without a byte, on a machine that is busy
MOST_WORDS = 2**23  # bytes of a message
POOL = {"ARROW_DEFAULT_MEMORY_POOL": "system"}  # others keep more than they are asked for
BUFFER = 2**20  # bytes between the processes, where the system lets us say so
PROGRAMS = Path(str(children.__file__)).parent
# the packages that it needs are the only ones that it finds
START = """
import runpy, sys
program, homes, *sys.argv[1:] = sys.argv[1:]
sys.path += homes.split("\\n")
runpy.run_path(program, run_name="__main__")
"""


class Child:
    """One of the programs in ``children``; it knows nothing of our folder and environment.

    Args:
        path: of the file that it reads.
        program: its name.
        arguments: of it.
        packages: that it imports.
        advice: what to do with a file that cannot be read.
    """

    def __init__(
        self,
        path: Path,
        program: str,
        arguments: Sequence[object],
        packages: Sequence[str],
        advice: str,
    ) -> None:
        self.advice = advice
        homes = "\n".join((*_homes(packages), str(PROGRAMS)))
        command = [sys.executable, "-I", "-S", "-c", START, str(PROGRAMS / program), homes]
        file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            self.process = subprocess.Popen(
                [*command, *map(str, arguments)],
                stdin=file,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={k: v for k, v in os.environ.items() if k == "LD_LIBRARY_PATH"} | POOL,
                start_new_session=True,
            )
        finally:
            os.close(file)
        assert self.process.stdout is not None
        self.output = self.process.stdout.fileno()
        self.waiting = select.poll()
        self.waiting.register(self.output, select.POLLIN)
        _widen(self.output)

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        """End it, whatever it is at."""
        self.process.kill()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.process.wait()

    def message(self) -> dict[str, Any]:
        """What it says of the file before the bytes.

        Raises:
            InputError: it refuses the file, or see :meth:`fill`.
        """
        length = bytearray(LENGTH.size)
        self.fill(memoryview(length))
        (count,) = LENGTH.unpack(length)
        if count > MOST_WORDS:
            raise InputError(f"its headers fill {count} bytes; {self.advice}")
        said = bytearray(count)
        self.fill(memoryview(said))
        held = json.loads(said)
        if "error" in held:
            raise InputError(held["error"])
        return held

    def fill(self, room: memoryview) -> None:
        """Read so many bytes.

        Raises:
            InputError: the child ended before, or says nothing any more.
        """
        while room:
            if not self.waiting.poll(1000 * PATIENCE):
                raise InputError(f"reading it hangs; {self.advice}")
            count = os.readv(self.output, [room])
            if not count:
                raise InputError(f"{self._why()}; {self.advice}")
            room = room[count:]

    def _why(self) -> str:
        code = self.process.wait()
        if code == -signal.SIGXCPU:
            return "reading it takes more processor time than it may"
        return f"reading it fails (code {code}), or needs more memory than it may"


def _homes(packages: Sequence[str]) -> list[str]:
    """Where these and what they need lie."""
    found = (importlib.util.find_spec(name) for name in (*packages, "numpy"))
    homes = [str(Path(s.origin).parents[1]) for s in found if s is not None and s.origin]
    return list(dict.fromkeys(homes))


def _widen(pipe: int) -> None:
    if hasattr(fcntl, "F_SETPIPE_SZ"):
        try:
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, BUFFER)
        except OSError:
            return  # a system that lets a user have less is slower, and no worse
