"""Units of work as jobs of Slurm, by submitit: for clusters where no server of ours may run.

Each task is a job of its own, which leaves what it finds in the run folder. Where there is no
Slurm, submitit makes a job a process of this machine.
"""

from __future__ import annotations

import json
import math
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from vidphys.errors import InputError
from vidphys.runs.atomic import write_json
from vidphys.runs.needs import Needs
from vidphys.runs.pool import Message
from vidphys.runs.tasks import Tasks
from vidphys.runs.worker import outcome, quietly_with_one_thread

POLL_SECONDS = 1.0
DAY_MINUTES = 24 * 60  # asked of a job unless SBATCH_TIMELIMIT says another time
GIB = 2**30
MISSING = "the engine submitit is not installed: pip install 'vidphys[submitit]'"


class Jobs:
    """See :class:`vidphys.runs.engine.Engine`.

    Args:
        workers: jobs that wait or run at once.
        folder: that all nodes see, for what submitit writes; it is deleted at the end.
        needs: of each task, in their order; of all that are not named, one core.

    Raises:
        InputError: submitit is not installed.
    """

    def __init__(self, workers: int, folder: Path, needs: Sequence[Needs]) -> None:
        try:
            import submitit
        except ImportError as error:
            raise InputError(MISSING) from error
        self.submitit: Any = submitit
        self.workers, self.folder, self.needs = workers, folder.resolve(), needs

    def __call__(
        self,
        work: Callable[..., None],
        tasks: Sequence[tuple[Any, ...]],
        show: Callable[[Message], None],
        finished: Callable[[int], None],
    ) -> list[tuple[int, Exception]]:
        """Submit the tasks. No job outlives this call, nor the next one where its driver died."""
        for left in self.folder.glob("*_submitted.pkl"):
            job = self._executor(0).job_class(self.folder, left.name.split("_")[0])
            job.cancel(check=False)
        running: dict[Any, int] = {}
        try:
            return self._run(running, work, tasks, show, finished)
        finally:
            for job in running:
                job.cancel(check=False)
            shutil.rmtree(self.folder, ignore_errors=True)

    def _run(
        self,
        running: dict[Any, int],
        work: Callable[..., None],
        tasks: Sequence[tuple[Any, ...]],
        show: Callable[[Message], None],
        finished: Callable[[int], None],
    ) -> list[tuple[int, Exception]]:
        kept = Tasks(len(tasks), finished)
        while kept.waiting or running:
            while kept.waiting and len(running) < self.workers:
                number = kept.waiting.popleft()
                said, executor = self._said(number), self._executor(number)
                running[executor.submit(_job, said, work, tasks[number])] = number
            time.sleep(POLL_SECONDS)
            for number in running.values():
                if self._said(number).exists():
                    show(tuple(json.loads(self._said(number).read_text(encoding="utf-8"))["at"]))
            for job in [job for job in running if job.done()]:
                number = running.pop(job)
                try:
                    found = job.result()
                except Exception as error:  # its own are told as outcomes
                    how = f"the job of task {number + 1} went away ({type(error).__name__})"
                    if kept.again(number, how):
                        kept.waiting.append(number)
                else:
                    kept.ended(number, found)
        return kept.failures

    def _executor(self, number: int) -> Any:
        """What submits a task's job, with what it asks for; a share of a card is a whole one."""
        needs = self.needs[number] if number < len(self.needs) else Needs()
        python = f"{sys.executable} -P"  # nothing of the current folder is imported
        made = self.submitit.AutoExecutor(self.folder, local_python=python, slurm_python=python)
        made.update_parameters(
            name="vidphys",
            timeout_min=DAY_MINUTES,
            cpus_per_task=math.ceil(needs.cores),
            gpus_per_node=math.ceil(needs.gpu),
            **({"mem_gb": math.ceil(needs.memory / GIB)} if needs.memory else {}),
        )
        return made

    def _said(self, number: int) -> Path:
        return self.folder / f"{number}.json"


def _job(said: Path, work: Callable[..., None], task: tuple[Any, ...]) -> tuple[Any, ...]:
    """In a job: one task, as a worker of this machine does it."""
    quietly_with_one_thread()
    last = -math.inf

    def report(stage: str, step: int, steps: int) -> None:
        nonlocal last
        if step == steps or time.monotonic() - last > POLL_SECONDS:
            last = time.monotonic()
            write_json(said, {"at": [stage, step, steps]})

    return outcome(work, task, report)
