"""The log of a unit of work: a file that says what it said, while it says it."""

from __future__ import annotations

import os
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from vidphys.runs.cost import peak_memory

MIB = 2**20
OUT, ERR = 1, 2  # what a process prints to, from compiled code too


def logged(
    work: Callable[..., None],
    log: Path,
    arguments: tuple[Any, ...],
    report: Callable[[str, int, int], None],
) -> None:
    """Call ``work(*arguments, report)``, and keep what it says in a file of its own.

    The file holds when the unit began and where, each of its stages, what it printed, its warnings,
    the trace of its error, and when it ended, with its seconds, those of them that its process
    computed, and the memory that the process has held at most. It can be read meanwhile. One
    without such an end is of a unit that was cut short; the next try is written below it.

    Args:
        work: ``report(stage, step, steps)`` is its last argument.
        log: the file.
        arguments: of the call.
        report: told as the work tells it.
    """
    with _opened(log) as file, _heard_in(file):
        seen: set[str] = set()

        def told(stage: str, step: int, steps: int) -> None:
            if stage not in seen:
                seen.add(stage)
                _note(file, stage)
            report(stage, step, steps)

        began, before, how = time.perf_counter(), time.process_time(), "cut short"
        try:
            work(*arguments, told)
            how = "done"
        except Exception:
            how = "failed"
            traceback.print_exc(file=file)
            raise
        finally:
            seconds, computed = time.perf_counter() - began, time.process_time() - before
            took = f"{seconds:.1f} s, {computed:.1f} s of them at work"
            _note(file, f"{how}: {took}, {peak_memory() / MIB:.0f} MiB of memory at most")


@contextmanager
def _opened(log: Path) -> Iterator[TextIO]:
    """The file, at its end, with the first line of this try; none is left without it."""
    log.parent.mkdir(parents=True, exist_ok=True)
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC
    number = os.open(log, flags, 0o666)
    with open(number, "a", buffering=1, encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123
        try:
            _note(file, f"begins in process {os.getpid()}")
        except OSError:
            if not os.fstat(number).st_size:
                log.unlink()
            raise
        yield file


@contextmanager
def _heard_in(file: TextIO) -> Iterator[None]:
    """What is printed goes into ``file``, by Python and by what it calls; so do warnings."""
    kept = {number: os.dup(number) for number in (OUT, ERR)}
    _flush()
    try:
        for number in kept:
            os.dup2(file.fileno(), number)
        with redirect_stdout(file), redirect_stderr(file), warnings.catch_warnings():
            yield  # within it, a warning that another unit gave is given again
    finally:
        _flush()
        for number, before in kept.items():
            os.dup2(before, number)
            os.close(before)


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()


def _note(file: TextIO, text: str) -> None:
    print(f"{datetime.now(UTC).isoformat(timespec='seconds')} {text}", file=file)
