"""The inside of a worker process: one task after the other, until its pipe or its parent ends.

Nothing heavy is imported before signals are heeded: while a worker starts they are blocked, see
:mod:`vidphys.runs.pool`.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from vidphys.runs.ending import INTERRUPTED, SIGNALS

BEAT_SECONDS = 5.0
GRACE_SECONDS = 3.0  # less than the parent's own
PR_SET_PDEATHSIG = 1
Work = Callable[..., None]


def serve(pipe: Connection) -> None:
    """Do what comes through ``pipe``: first the function, then its arguments, then ``None``.

    What is said back: ``("at", stage, step, steps)``, ``("alive",)``, ``("done",)`` and
    ``("failed", exception)``.
    """
    said = _Said(pipe)
    for number in SIGNALS:
        signal.signal(number, _leave)  # what a training puts in its place saves a step first
    signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
    end_with_parent()
    threading.Thread(target=_watch, args=(said,), daemon=True).start()
    try:
        quietly_with_one_thread()
        work: Work = pipe.recv()
        while (task := pipe.recv()) is not None:
            said(outcome(work, task, said.report))
    except (EOFError, OSError, KeyboardInterrupt):
        os._exit(INTERRUPTED)


class _Said:
    """Messages to the parent, from any thread; those to one that is gone go nowhere."""

    def __init__(self, pipe: Connection) -> None:
        self.pipe, self.lock = pipe, threading.Lock()

    def __call__(self, message: tuple[Any, ...]) -> None:
        with self.lock, contextlib.suppress(OSError):
            self.pipe.send(message)

    def report(self, stage: str, step: int, steps: int) -> None:
        if step == steps or step % 20 == 0:
            self(("at", stage, step, steps))


def outcome(
    work: Work, task: tuple[Any, ...], report: Callable[[str, int, int], None]
) -> tuple[Any, ...]:
    """Do a task: ``("done",)``, or ``("failed", exception)``."""
    try:
        work(*task, report)
    except Exception as error:
        return "failed", _sendable(error)
    return ("done",)


def _sendable(error: Exception) -> Exception:
    """The exception itself where it arrives as what it is, else its text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error


def quietly_with_one_thread() -> None:
    """What a process is told before its first task: others compute beside it."""
    import warnings

    import torch

    from dynamics.findings import DynamicsWarning

    torch.set_num_threads(1)
    # a worker measures drift and failure of its rollouts and records them
    warnings.simplefilter("ignore", DynamicsWarning)


def _leave(*_: object) -> None:
    os._exit(INTERRUPTED)


def end_with_parent() -> None:
    """Have the system tell this process to end when its parent does; elsewhere the watch does."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(said: _Said) -> None:
    """Say from time to time that the process is alive; end it with its parent, work kept."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    while parent.is_alive():
        said(("alive",))
        parent.join(BEAT_SECONDS)
    os.kill(os.getpid(), signal.SIGTERM)  # heeded by the main thread: a training saves its step
    threading.Event().wait(GRACE_SECONDS)
    os._exit(INTERRUPTED)
