"""Where units of work run: processes of this machine, a Ray cluster, or jobs; chosen here alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol

from vidphys.errors import InputError
from vidphys.runs.cards import cards
from vidphys.runs.needs import Needs
from vidphys.runs.pool import Message

EngineName = Literal["local", "ray", "submitit"]


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
            :class:`vidphys.runs.tasks.WorkerLost`; the others go on.
        """
        ...


def engine_of(
    name: EngineName,
    workers: int,
    address: str | None = None,
    needs: Sequence[Needs] = (),
    jobs: Path = Path("jobs"),
) -> Engine:
    """The engine of a name.

    Args:
        name: ``local``, ``ray`` or ``submitit``.
        workers: processes of this machine; of a cluster that is started here, its cores; jobs that
            wait or run at once.
        address: of a Ray cluster that runs already; ``None`` starts one on this machine.
        needs: of each task, in their order; of all that are not named, one core. On this machine
            ``workers`` says how many run at once, and each worker is given a card in turn.
        jobs: folder that all nodes see, for what submitit writes while jobs run.

    Raises:
        InputError: what the engine needs is not installed, or an address of another than ray.
    """
    if address is not None and name != "ray":
        raise InputError("`address`: is of a Ray cluster; use it with the engine ray")
    if name == "ray":
        from vidphys.runs.cluster import Cluster

        return Cluster(workers, address, needs)
    if name == "submitit":
        from vidphys.runs.jobs import Jobs

        return Jobs(workers, jobs, needs)
    from vidphys.runs.pool import run_all

    shared = cards() if any(need.gpu for need in needs) else []
    return partial(_local, run_all, workers, shared)


def _local(
    run_all: Callable[..., list[tuple[int, Exception]]],
    workers: int,
    shared: Sequence[str],
    work: Callable[..., None],
    tasks: Sequence[tuple[Any, ...]],
    show: Callable[[Message], None],
    finished: Callable[[int], None],
) -> list[tuple[int, Exception]]:
    return run_all(work, tasks, workers, show, finished, shared)
