"""Work that is done before it is asked for, in the order in which it will be."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice
from queue import Queue
from threading import Event, Thread
from time import perf_counter, thread_time
from typing import TypeVar

T = TypeVar("T")
QUICK = 0.002  # seconds of a piece of work, below which its hand-over costs more than it gains
WORKED = 0.1  # of them by the processor, below which the process only waited for its turn


def ahead(work: Iterable[Callable[[], T]], most: int = 2) -> Iterator[T]:
    """Results in order, ``most`` of them made at once while an earlier one is used.

    That begins with a piece that takes its time, and ends with one that only waited for its turn:
    others are made when they are asked for. What goes wrong is raised where its result is asked
    for.

    Example:
        >>> [*ahead([lambda: 1, lambda: 2, lambda: 3])]
        [1, 2, 3]
    """
    coming = iter(work)
    for each in coming:
        begun = perf_counter()
        found = each()
        if perf_counter() - begun > QUICK:
            yield from _by_threads(found, coming, most)
        else:
            yield found


def _by_threads(first: T, coming: Iterator[Callable[[], T]], most: int) -> Iterator[T]:
    with ThreadPoolExecutor(most) as pool:
        waiting = deque(pool.submit(_timed, each) for each in islice(coming, most))
        try:
            yield first
            while waiting:
                found, worked = waiting.popleft().result()
                if worked > WORKED * QUICK:
                    waiting.extend(pool.submit(_timed, each) for each in islice(coming, 1))
                yield found
        finally:
            for future in waiting:
                future.cancel()


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    """What it gives, and the seconds of the processor; to ask for those alone takes a while."""
    begun = thread_time()
    return work(), thread_time() - begun


def prefetched(items: Iterable[T], most: int = 2) -> Iterator[T]:
    """The items, up to ``most`` of them made before they are asked for, by a thread.

    Example:
        >>> [*prefetched(range(4))]
        [0, 1, 2, 3]
    """
    queue: Queue[tuple[bool, object]] = Queue(most)
    left = Event()

    def make() -> None:
        try:
            for item in items:
                queue.put((True, item))
                if left.is_set():
                    return
            queue.put((False, None))
        except BaseException as error:
            queue.put((False, error))

    thread = Thread(target=make, daemon=True)
    thread.start()
    try:
        while True:
            good, item = queue.get()
            if not good:
                if isinstance(item, BaseException):
                    raise item
                return
            yield item  # type: ignore[misc]
    finally:
        left.set()
        while thread.is_alive():  # it may wait to put what nobody takes
            while not queue.empty():
                queue.get()
            thread.join(0.01)
