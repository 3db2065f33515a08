"""What a verb shows while it works: bars on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from rich.console import Console as RichConsole
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from vidphys.errors import InputError

LINE_SECONDS = 10.0


class Console:
    """Progress of a known number of units of work, as a context."""

    def __init__(self, quiet: bool, units: int, name: str) -> None:
        self.quiet, self.units, self.name = quiet, units, name
        self.rich = RichConsole(stderr=True)
        self.live = self.rich.is_terminal and not quiet
        self.finished = 0
        self.began = self.last_line = time.monotonic()
        self.bars: dict[str, TaskID] = {}

    def __enter__(self) -> Console:
        if self.live:
            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
            )
            self.progress = Progress(*columns, console=self.rich, transient=True)
            self.progress.start()
            self.total = self.progress.add_task(self.name, total=self.units)
        elif not self.quiet and self.units > 1:
            self._line(f"0 of {self.units} units finished")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.live:
            self.progress.stop()

    def stage(self, message: tuple[str, int, int]) -> None:
        """Show how far one stage of one worker is."""
        name, step, steps = message
        if self.live:
            if name not in self.bars:
                self.bars[name] = self.progress.add_task(name, total=steps)
            self.progress.update(self.bars[name], completed=step, visible=step < steps)
        else:
            self._seldom(f"{name}: {step} of {steps} ({step / max(steps, 1):.0%})")

    @contextmanager
    def busy(self, what: str) -> Iterator[None]:
        """Say now and then that ``what`` goes on, where nothing says how far it is."""
        if self.live:
            task = self.progress.add_task(what, total=None)
            try:
                yield
            finally:
                self.progress.remove_task(task)
            return
        over = threading.Event()

        def tell() -> None:
            while not over.wait(LINE_SECONDS):
                self._seldom(f"{what} goes on")

        thread = threading.Thread(target=tell, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()

    def done(self, _index: int) -> None:
        """Count one finished unit."""
        self.finished += 1
        if self.live:
            self.progress.update(self.total, completed=self.finished)
        elif not self.quiet:
            share = self.finished / self.units
            left = (time.monotonic() - self.began) * (1 - share) / share
            more = f" ({share:.0%}), about {_span(left)} left" if share < 1 else ""
            self._line(f"{self.finished} of {self.units} units finished{more}")

    def note(self, text: str) -> None:
        """Say what was found on the way; a record has it too."""
        if not self.quiet:
            print(text, file=sys.stderr)

    def warn(self, text: str) -> None:
        """Say something that must not be missed, even when quiet."""
        print(f"warning: {text}", file=sys.stderr)

    @contextmanager
    def drawing(self, what: str) -> Iterator[None]:
        """Warn of a drawing that fails; the numbers are written before it, and stay.

        Raises:
            InputError: of what the user asked for.
        """
        try:
            yield
        except InputError:
            raise
        except Exception as error:  # whatever a viewer's library raises
            said = " ".join(str(error).split())
            self.warn(f"{what} could not be drawn ({type(error).__name__}: {said})")

    def result(self, text: str) -> None:
        """The last word, on standard output."""
        print(text)

    def _seldom(self, text: str) -> None:
        """A line, where the last one is old and none is unwanted."""
        if not self.quiet and time.monotonic() - self.last_line >= LINE_SECONDS:
            self._line(text)

    def _line(self, text: str) -> None:
        self.last_line = time.monotonic()
        seconds = time.monotonic() - self.began
        print(f"[{self.name} {seconds:6.0f} s] {text}", file=sys.stderr, flush=True)


def _span(seconds: float) -> str:
    """In the unit that a person would say it in."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
