"""Processes that work side by side; one that dies takes down its own task only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from vidphys.runs.cards import least_used, seeing
from vidphys.runs.ending import SIGNALS
from vidphys.runs.tasks import Tasks, WorkerWarning
from vidphys.runs.worker import serve

Message = tuple[str, int, int]
POLL_SECONDS = 0.5
DEAF_SECONDS = 180.0  # without a sign of life, after which a worker is given up
STUCK_SECONDS = 900.0  # without progress, after which a worker's task is warned of
END_SECONDS = 3.0  # for workers to end by themselves


class _Worker:
    """One process, the task that it is at, and what it last said."""

    def __init__(self, work: Callable[..., None], card: str | None) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.card = card
        self.task: int | None = None
        self.silent = self.idle = 0.0
        self.stage = "its start"
        # A child begins with the same signals blocked, until it can heed them. Python's tracker of
        # shared resources comes first: its start takes the block away.
        with _safe_path():
            resource_tracker.ensure_running()
        with _blocked_signals(), _safe_path(), seeing(card):
            self.process: SpawnProcess = context.Process(target=serve, args=(theirs,), daemon=True)
            self.process.start()
        theirs.close()
        self.send(work)

    def give(self, number: int, task: tuple[Any, ...]) -> None:
        self.task, self.silent, self.idle, self.stage = number, 0.0, 0.0, "its start"
        self.send(task)

    def send(self, what: Any) -> None:
        with suppress(OSError):  # it is dead, as its pipe's end tells
            self.pipe.send(what)

    def waited(self, seconds: float) -> None:
        """Count time without a word; one that is deaf is killed, which its pipe then tells."""
        stuck = self.idle < STUCK_SECONDS <= self.idle + seconds
        self.silent, self.idle = self.silent + seconds, self.idle + seconds
        if self.silent > DEAF_SECONDS:
            self.process.kill()
        elif stuck:
            warnings.warn(
                f"nothing new from {self.stage} for {STUCK_SECONDS:.0f} s: it, or its disk, may be "
                "stuck; an interrupt keeps what is finished",
                WorkerWarning,
                stacklevel=4,
            )

    def end_of(self) -> str:
        """How the process ended."""
        self.process.join(END_SECONDS)
        code = self.process.exitcode
        if code is None or code >= 0:
            return f"exit code {code}"
        hint = ", memory may have run out" if code == -signal.SIGKILL else ""
        return f"{signal.Signals(-code).name}{hint}"


def run_all(
    work: Callable[..., None],
    tasks: Sequence[tuple[Any, ...]],
    workers: int,
    show: Callable[[Message], None],
    finished: Callable[[int], None],
    cards: Sequence[str] = (),
) -> list[tuple[int, Exception]]:
    """Call ``work(*task, report)`` for each task in ``workers`` processes of one thread each.

    A task whose process dies is tried again, twice at most. Interrupted, or with this process gone,
    the workers end too.

    Args:
        work: a module-level function; ``report(stage, step, steps)`` is its last argument.
        tasks: arguments of each call.
        workers: processes.
        show: called here with each message.
        finished: called here with the number of each task that ended well.
        cards: given to the workers in turn, each of which sees its own alone.

    Returns:
        The tasks that raised, with what they raised, or :class:`vidphys.runs.tasks.WorkerLost`; the
        others go on.
    """
    kept, staff = Tasks(len(tasks), finished), list[_Worker]()
    waiting = kept.waiting
    try:
        while waiting or any(worker.task is not None for worker in staff):
            while waiting and (worker := _free(staff, workers, work, cards)):
                worker.give(waiting[0], tasks[waiting[0]])
                waiting.popleft()
            for worker, message in _heard(staff):
                number = worker.task
                if message is None:
                    staff.remove(worker)
                    if number is not None:
                        how = f"the process at {worker.stage} died ({worker.end_of()})"
                        if kept.again(number, how):
                            waiting.appendleft(number)
                elif message[0] == "at":
                    worker.stage = message[1]
                    show(message[1:])
                elif message[0] in ("done", "failed") and number is not None:
                    worker.task = None
                    kept.ended(number, message)
        for worker in staff:
            worker.send(None)
    finally:
        _end(staff)
    return kept.failures


def _free(
    staff: list[_Worker], workers: int, work: Callable[..., None], cards: Sequence[str]
) -> _Worker | None:
    """A worker without a task, started if there may be another one."""
    for worker in staff:
        if worker.task is None:
            return worker
    if len(staff) == workers:
        return None
    with _blocked_signals():  # none is started and then not known of
        staff.append(_Worker(work, least_used(cards, [worker.card for worker in staff])))
    return staff[-1]


def _heard(staff: Sequence[_Worker]) -> Iterator[tuple[_Worker, tuple[Any, ...] | None]]:
    """What workers say within :data:`POLL_SECONDS`; ``None`` of one that is dead."""
    of = {worker.pipe: worker for worker in staff}
    began = time.monotonic()
    spoke = [of[pipe] for pipe in wait(list(of), POLL_SECONDS) if isinstance(pipe, Connection)]
    passed = min(time.monotonic() - began, POLL_SECONDS)  # not what this process itself slept
    for worker in staff:
        worker.waited(passed)
    for worker in spoke:
        worker.silent = 0.0
        try:
            message = worker.pipe.recv()
        except (EOFError, OSError):
            message = None
        if message != ("alive",):
            worker.idle = 0.0
        yield worker, message


def _end(staff: Sequence[_Worker]) -> None:
    """Let idle workers end, tell busy ones to, and kill what is left."""
    for worker in staff:
        if worker.task is not None:
            worker.process.terminate()
    until = time.monotonic() + END_SECONDS
    for worker in staff:
        worker.process.join(max(0.0, until - time.monotonic()))
        if worker.process.is_alive():
            worker.process.kill()
        worker.pipe.close()


@contextmanager
def _blocked_signals() -> Iterator[None]:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _safe_path() -> Iterator[None]:
    """A child must not import what lies in the current folder under a library's name."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
