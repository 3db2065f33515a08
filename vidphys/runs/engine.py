"""Where units of work run: processes of this machine, or a Ray cluster; chosen here alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, Protocol

from vidphys.errors import InputError
from vidphys.runs.needs import Needs
from vidphys.runs.pool import Message

EngineName = Literal["local", "ray"]


class Engine(Protocol):
    """Calls a function for each task, side by side; what :func:`vidphys.runs.pool.run_all` does."""

    def __call__(
        self,
        work: Callable[..., None],
        tasks: Sequence[tuple[Any, ...]],
        show: Callable[[Message], None],
        finished: Callable[[int], None],
    ) -> list[tuple[int, Exception]]:
        """Call ``work(*task, report)`` for each task.

        A task whose process is lost is tried again, twice at most. What a task leaves, it writes
        itself, under a name of its own and at one stroke: nothing is handed back.

        Args:
            work: a module-level function; ``report(stage, step, steps)`` is its last argument.
            tasks: arguments of each call.
            show: called here with each message.
            finished: called here with the number of each task that ended well.

        Returns:
            The tasks that raised, with what they raised, or
            :class:`vidphys.runs.pool.WorkerLost`; the others go on.
        """
        ...


def engine_of(
    name: EngineName, workers: int, address: str | None = None, needs: Needs | None = None
) -> Engine:
    """The engine of a name.

    Args:
        name: ``local`` or ``ray``.
        workers: processes of this machine; of a cluster that is started here, its cores.
        address: of a Ray cluster that runs already; ``None`` starts one on this machine.
        needs: of each task; on this machine ``workers`` says how many run at once.

    Raises:
        InputError: Ray is not installed, or an address without it.
    """
    if name == "local":
        if address is not None:
            raise InputError("`address`: is of a Ray cluster; use it with the engine ray")
        from vidphys.runs.pool import run_all

        return partial(_local, run_all, workers)
    from vidphys.runs.cluster import Cluster

    return Cluster(workers, address, needs or Needs())


def _local(
    run_all: Callable[..., list[tuple[int, Exception]]],
    workers: int,
    work: Callable[..., None],
    tasks: Sequence[tuple[Any, ...]],
    show: Callable[[Message], None],
    finished: Callable[[int], None],
) -> list[tuple[int, Exception]]:
    return run_all(work, tasks, workers, show, finished)
