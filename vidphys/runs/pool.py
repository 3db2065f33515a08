"""A process pool that shows what each worker is at and stops cleanly on interrupt."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
import threading
import warnings
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from typing import Any

import torch

from dynamics.findings import DynamicsWarning

Message = tuple[str, int, int]
POLL_SECONDS = 0.5
INTERRUPTED = 130  # exit status of a worker that was told to stop


def run_all(
    work: Callable[..., None],
    tasks: list[tuple[Any, ...]],
    workers: int,
    show: Callable[[Message], None],
    finished: Callable[[int], None],
) -> list[tuple[int, Exception]]:
    """Call ``work(*task, report)`` for each task in ``workers`` processes of one thread each.

    Args:
        work: a module-level function; ``report(stage, step, steps)`` is its last argument.
        tasks: arguments of each call.
        workers: processes.
        show: called here with each message.
        finished: called here with the number of each task that ended well.

    Returns:
        The tasks that raised, with what they raised; the others go on.
    """
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager:
        messages = manager.Queue()
        pool = ProcessPoolExecutor(workers, context, _begin)
        try:
            pending = {pool.submit(_call, work, task, messages): i for i, task in enumerate(tasks)}
            failures = []
            while pending:
                done, _ = wait(pending, POLL_SECONDS, FIRST_COMPLETED)
                _drain(messages, show)
                for future in done:
                    index = pending.pop(future)
                    error = future.exception()
                    if isinstance(error, Exception):
                        failures.append((index, error))
                    else:
                        finished(index)
            return failures
        except KeyboardInterrupt:
            for process in (getattr(pool, "_processes", None) or {}).values():
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _call(work: Callable[..., None], task: tuple[Any, ...], messages: Any) -> None:
    def report(stage: str, step: int, steps: int) -> None:
        if step == steps or step % 20 == 0:
            messages.put((stage, step, steps))

    # a worker measures drift and failure of its rollouts and records them
    warnings.simplefilter("ignore", DynamicsWarning)
    try:
        work(*task, report)
    except KeyboardInterrupt:
        os._exit(INTERRUPTED)  # else the pool would hand this worker the next task


def _begin() -> None:
    """Give this worker one thread; let it end, as on an interrupt, when its parent is gone."""
    torch.set_num_threads(1)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def _drain(messages: Any, show: Callable[[Message], None]) -> None:
    while True:
        try:
            show(messages.get_nowait())
        except queue.Empty:
            return
