"""Units of work on a Ray cluster: retried where a process or a node is lost, and told of here.

Ray is asked for processes and nothing else. What a unit finds it writes into the run folder, which
all nodes see, so that a driver that died loses nothing that was finished.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from vidphys.errors import InputError
from vidphys.runs.ending import SIGNALS
from vidphys.runs.needs import Needs
from vidphys.runs.pool import Message
from vidphys.runs.tasks import Tasks
from vidphys.runs.worker import outcome, quietly_with_one_thread

POLL_SECONDS = 0.5
STORE_BYTES = 2**27  # of objects, which pass through it by name only
# Of a cluster that is started here. On a machine that has much to do its processes start late, and
# would be given up; and at the niceness of 15 that Ray gives them, its workers would get no time.
OWN = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_worker_niceness": "0",
    "RAY_raylet_start_wait_time_s": "120",
    "RAY_agent_register_timeout_ms": "120000",
    "RAY_worker_register_timeout_seconds": "180",
}
MISSING = "the engine ray needs Ray, which is not installed: pip install 'vidphys[ray]'"


class Cluster:
    """See :class:`vidphys.runs.engine.Engine`.

    Args:
        workers: cores of a cluster that is started here.
        address: of one that runs already, such as ``auto`` or ``10.0.0.1:6379``; ``None`` starts
            one on this machine, which ends with this process.
        needs: of each task, in their order; of all that are not named, one core.

    Raises:
        InputError: Ray is not installed.
    """

    def __init__(self, workers: int, address: str | None, needs: Sequence[Needs]) -> None:
        try:
            import ray
        except ImportError as error:
            raise InputError(MISSING) from error
        self.ray: Any = ray
        self.workers, self.address, self.needs = workers, address, needs

    def __call__(
        self,
        work: Callable[..., None],
        tasks: Sequence[tuple[Any, ...]],
        show: Callable[[Message], None],
        finished: Callable[[int], None],
    ) -> list[tuple[int, Exception]]:
        """Run the tasks on the cluster, which is left again however that ends."""
        self._join()
        try:
            return self._run(work, tasks, show, finished)
        finally:
            self.ray.shutdown()  # its tasks end with their driver

    def _join(self) -> None:
        # A task without a share of a card sees none; Ray says of itself that this will be so.
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        own: dict[str, Any] = {"num_cpus": self.workers, "object_store_memory": STORE_BYTES}
        if self.address is None:
            # "local", else Ray looks for a cluster itself, and finds traces of one that is gone.
            where = {"address": "local", "include_dashboard": False, **own}
            set_up_own()
        else:
            where = {"address": self.address}
        try:
            with _own_signals():
                self.ray.init(**where, log_to_driver=False, logging_level=logging.WARNING)
        except Exception as error:  # Ray raises whatever stopped it, of no common kind
            what = "cannot be started here" if self.address is None else f"at {self.address}: none"
            raise InputError(f"a Ray cluster {what} ({error})") from error

    def _run(
        self,
        work: Callable[..., None],
        tasks: Sequence[tuple[Any, ...]],
        show: Callable[[Message], None],
        finished: Callable[[int], None],
    ) -> list[tuple[int, Exception]]:
        ray, kept = self.ray, Tasks(len(tasks), finished)
        board = ray.remote(num_cpus=0, max_restarts=-1)(_Board).remote()
        call = ray.remote(max_retries=0)(_call)
        asked = self._asked(len(tasks))
        running: dict[Any, int] = {}
        while kept.waiting or running:
            while kept.waiting:
                number = kept.waiting.popleft()
                begun = call.options(**asked[number])
                running[begun.remote(board, number, work, tasks[number])] = number
            ready, _ = ray.wait(list(running), timeout=POLL_SECONDS)
            for message in self._news(board):
                show(message)
            for reference in ready:
                number = running.pop(reference)
                try:
                    found = ray.get(reference)
                except ray.exceptions.RayError as error:
                    how = f"the process of task {number + 1} went away ({type(error).__name__})"
                    if kept.again(number, how):
                        kept.waiting.append(number)
                else:
                    kept.ended(number, found)
        return kept.failures

    def _asked(self, count: int) -> list[dict[str, Any]]:
        """What each task asks the cluster for: no more cores or memory than its largest node has.

        A task that asked for more would wait for ever.
        """
        nodes = [node["Resources"] for node in self.ray.nodes() if node["Alive"]]
        cores = max((node.get("CPU", 1.0) for node in nodes), default=1.0)
        memory = max((node.get("memory", 0.0) for node in nodes), default=0.0)
        needs = [*self.needs, *[Needs()] * (count - len(self.needs))]
        return [
            {
                "num_cpus": min(need.cores, cores),
                "num_gpus": need.gpu,
                **({"memory": int(min(need.memory, memory))} if need.memory else {}),
            }
            for need in needs
        ]

    def _news(self, board: Any) -> list[Message]:
        """What tasks said; nothing while the board itself is being made anew."""
        try:
            return self.ray.get(board.take.remote(), timeout=10 * POLL_SECONDS)
        except (self.ray.exceptions.RayError, TimeoutError):
            return []


def set_up_own() -> None:
    """Tell Ray of a cluster that it is about to start here."""
    for name, value in OWN.items():
        os.environ.setdefault(name, value)


@contextmanager
def _own_signals() -> Iterator[None]:
    """Ray takes SIGTERM for itself; here it means that the work is kept and the process ends."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for number, handler in before.items():
                signal.signal(number, handler)


class _Board:
    """The last that each task said, until the driver takes it."""

    def __init__(self) -> None:
        self.said: dict[int, Message] = {}

    def say(self, number: int, message: Message) -> None:
        self.said[number] = message

    def take(self) -> list[Message]:
        told, self.said = list(self.said.values()), {}
        return told


def _call(
    board: Any, number: int, work: Callable[..., None], task: tuple[Any, ...]
) -> tuple[Any, ...]:
    """In a process of the cluster: one task, as a worker of this machine does it."""
    quietly_with_one_thread()

    def report(stage: str, step: int, steps: int) -> None:
        if step == steps or step % 20 == 0:
            board.say.remote(number, (stage, step, steps))

    return outcome(work, task, report)
