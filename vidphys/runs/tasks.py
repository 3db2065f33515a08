"""Tasks of an engine: which wait, which failed, and which were lost and are tried again."""

from __future__ import annotations

import warnings
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

TRIES = 3  # of a task whose worker dies


class WorkerLost(RuntimeError):
    """The process that did a task died each time."""


class WorkerWarning(UserWarning):
    """A worker died or makes no progress."""


class Tasks:
    """What became of each task, by its number.

    Args:
        count: of tasks, all of which wait.
        finished: called with the number of each task that ended well.
    """

    def __init__(self, count: int, finished: Callable[[int], None]) -> None:
        self.waiting = deque(range(count))
        self.failures: list[tuple[int, Exception]] = []
        self._lost, self._finished = Counter[int](), finished

    def ended(self, number: int, outcome: tuple[Any, ...]) -> None:
        """Note how a task ended, as :func:`vidphys.runs.worker.outcome` tells it."""
        if outcome[0] == "done":
            self._finished(number)
        else:
            self.failures.append((number, outcome[1]))

    def again(self, number: int, how: str) -> bool:
        """Whether a task that was lost is to be tried again; else it failed.

        Args:
            number: of the task.
            how: it was lost, in words.
        """
        self._lost[number] += 1
        if self._lost[number] == TRIES:
            self.failures.append((number, WorkerLost(f"{how}, as {TRIES - 1} did before it")))
            return False
        warnings.warn(f"{how}; its work is tried again", WorkerWarning, stacklevel=3)
        return True
