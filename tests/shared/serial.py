"""The process pool without processes."""

from __future__ import annotations


def serially(work, tasks, _workers, _show, finished, _cards=()):
    """In place of processes, which take longer to start than the work does."""
    failures = []
    for number, task in enumerate(tasks):
        try:
            work(*task, lambda *_: None)
            finished(number)
        except Exception as error:
            failures.append((number, error))
    return failures
