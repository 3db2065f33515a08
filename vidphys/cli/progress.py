"""Progress for people: a bar on a terminal, a plain line now and then otherwise, or nothing."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from vidphys.train import Progress

SECONDS_BETWEEN_LINES = 10.0


@contextmanager
def progress(label: str, quiet: bool) -> Iterator[Progress]:
    """Give a ``(step, steps, loss)`` callback that shows how far ``label`` is, on stderr."""
    if quiet:
        yield lambda step, steps, loss: None
    elif sys.stderr.isatty():
        with _bar(label) as callback:
            yield callback
    else:
        yield _lines(label)


@contextmanager
def _bar(label: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import Progress as Bars

    with Bars(console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task(label, total=None)
        yield lambda step, steps, loss: bars.update(task, completed=step, total=steps)


def _lines(label: str) -> Progress:
    last = time.monotonic()

    def show(step: int, steps: int, loss: float) -> None:
        nonlocal last
        if time.monotonic() - last >= SECONDS_BETWEEN_LINES:
            last = time.monotonic()
            print(f"{label}: {step} of {steps}", file=sys.stderr, flush=True)

    return show
