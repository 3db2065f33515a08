"""What verbs share whose work is cut into units: their options, and how the units are run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from vidphys.errors import InputError

if TYPE_CHECKING:
    from vidphys.cli.console import Console
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.units import WorkUnit

SKIPPED = "skipped"  # how the reason begins of what was not run for want of weights


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """Where units of work run.

    Args:
        workers: how many processes, or jobs, share the work.
        engine: where units of work run: processes of this machine; a Ray cluster (the extra ray);
            or jobs of Slurm, one for each unit (the extra submitit). All nodes must see the run
            folder.
        address: of a Ray cluster that runs already, such as auto or HOST:6379; without it one is
            started on this machine, with so many cores as there are workers.
    """

    workers: int = 2
    engine: Literal["local", "ray", "submitit"] = "local"
    address: str | None = None

    def check_workers(self) -> None:
        """See that somebody works.

        Raises:
            InputError: nobody does.
        """
        if self.workers < 1:
            raise InputError(f"--workers {self.workers}: at least one process is needed")

    def check_engine(self) -> None:
        """See that the engine is there, before anything is written; a plan needs none.

        Raises:
            InputError: what it needs is not installed, or an address of another than ray.
        """
        from vidphys.runs.engine import engine_of

        engine_of(self.engine, self.workers, self.address)


def run_units(
    run: RunFolder,
    work: Callable[..., None],
    units: Sequence[WorkUnit],
    options: EngineOptions,
    console: Console,
) -> int:
    """Do every unit that is not done yet; one that fails is named in the run folder, others go on.

    Args:
        run: its folder, with a log of each unit in ``logs``.
        work: a module-level function; the run folder's path comes first, ``report`` last.
        units: each apart from the others.
        options: where they run.
        console: that shows how far they are.

    Returns:
        How many failed. A unit whose encoder's weights are not on this machine is skipped, which
        is no failure.

    Raises:
        InputError: the engine is not there.
    """
    from encoders.release import WeightsMissing
    from vidphys.runs.engine import engine_of
    from vidphys.runs.log import logged

    left = [unit for unit in units if not unit.is_done(run)]
    for number in range(len(units) - len(left)):
        console.done(number)
    needs = [unit.needs for unit in left]
    engine = engine_of(options.engine, options.workers, options.address, needs, run.jobs)
    tasks = [(work, run.log(unit.name), (run.path, *unit.arguments)) for unit in left]
    failed, lost = 0, set()
    wanting: dict[str, dict[str, None]] = {}  # what was not run, by what it misses
    for index, error in engine(logged, tasks, console.stage, console.done) if tasks else ():
        unit, absent = left[index], isinstance(error, WeightsMissing)
        failed += not absent
        word = SKIPPED if absent else f"failed: {type(error).__name__}"
        for part, cell in unit.parts.items():
            if not run.is_done(part):
                lost.add(cell)
                run.skip(cell, f"{word}: {error}")
                if absent:
                    wanting.setdefault(str(error), {})[unit.subject] = None
                else:
                    console.warn(f"{part} {word}: {error}; its log: {run.log(unit.name)}")
    for why, subjects in wanting.items():
        console.warn(f"{', '.join(subjects)} {SKIPPED}: {why}")
    run.unskip({cell for unit in units for cell in unit.parts.values()} - lost)
    return failed
