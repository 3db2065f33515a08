"""What ``ladder`` and ``reproduce`` share: their options, and how their units of work are run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vidphys.devices import check_cuda
from vidphys.errors import InputError
from vidphys.presets import Preset, preset

if TYPE_CHECKING:
    from vidphys.cli.console import Console
    from vidphys.experiments.core.cell import Unit
    from vidphys.runs.folder import RunFolder

LONG_SECONDS = 60.0  # of a run that is worth a word on how long it takes
SKIPPED = "skipped"  # how the reason begins of what was not run for want of weights


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """How large a study is, and how it is computed.

    Args:
        preset: sizes and seeds; quick is minutes on two cores.
        seed: the first seed. Those below 100 are for development; figures are reported from 100.
        seeds: how many from there on, instead of the preset's number.
        workers: how many processes share the work.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        device: where models are trained and rolled; references and scores are on the CPU.
        engine: where units of work run: processes of this machine, or a Ray cluster (the extra
            ray), whose nodes all see the run folder.
        address: of a Ray cluster that runs already, such as auto or HOST:6379; without it one is
            started on this machine, with so many cores as there are workers.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    preset: Literal["quick", "standard", "paper"] = "quick"
    seed: int = 0
    seeds: int | None = None
    workers: int = 2
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    engine: Literal["local", "ray"] = "local"
    address: str | None = None
    overwrite: bool = False
    quiet: bool = False

    def sizes(self) -> tuple[Preset, range]:
        """The preset, and the seeds.

        Raises:
            InputError: no worker or seed, or a device that is not there.
        """
        check_cuda(self.device)
        if self.workers < 1:
            raise InputError(f"--workers {self.workers}: at least one process is needed")
        sizes = preset(self.preset)
        seeds = sizes.seeds if self.seeds is None else self.seeds
        if seeds < 1:
            raise InputError(f"--seeds {seeds}: at least one seed is needed")
        if self.seed < 0:
            raise InputError(f"--seed {self.seed}: a seed is 0 or more")
        return sizes, range(self.seed, self.seed + seeds)


@contextmanager
def option(name: str) -> Iterator[None]:
    """Say of which option a value is wrong.

    Raises:
        InputError: in place of the library's error.
    """
    try:
        yield
    except ValueError as error:
        raise InputError(f"{name}: {error}") from error


def run_units(
    run: RunFolder, units: Sequence[Unit], sizes: Preset, config: StudyOptions, console: Console
) -> int:
    """Do every unit of a study; one that fails is named in the run folder and the others go on.

    Returns:
        How many failed. A unit whose encoder's weights are not on this machine is skipped, which
        is no failure.
    """
    from dynamics.compiled.ahead import compile_ahead
    from encoders.release import WeightsMissing
    from vidphys.experiments.study import run_unit
    from vidphys.runs.engine import engine_of
    from vidphys.runs.needs import Needs

    share = 1 / config.workers if config.device == "cuda" else 0.0
    engine = engine_of(config.engine, config.workers, config.address, Needs(gpu=share))
    _foretell(run, units, sizes, config, console)
    if min(config.workers, len(units)) > 1:
        console.stage(("compiling", 0, 1))
        compile_ahead()
        console.stage(("compiling", 1, 1))
    failed, lost = 0, set()
    wanting: dict[str, dict[str, None]] = {}  # rungs by what they miss
    tasks = [(run.path, unit, sizes, config.device) for unit in units]
    for index, error in engine(run_unit, tasks, console.stage, console.done):
        unit, absent = units[index], isinstance(error, WeightsMissing)
        failed += not absent
        word = SKIPPED if absent else f"failed: {type(error).__name__}"
        for cell, part in zip(unit.cells, unit.parts, strict=True):
            if not run.is_done(part):
                lost.add(f"{unit.table}/{cell}")
                run.skip(f"{unit.table}/{cell}", f"{word}: {error}")
                if absent:
                    wanting.setdefault(str(error), {})[cell.partition("/")[0]] = None
                else:
                    console.warn(f"{part} {word}: {error}")
    for why, rungs in wanting.items():
        console.warn(f"{', '.join(rungs)} {SKIPPED}: {why}")
    run.unskip({f"{unit.table}/{cell}" for unit in units for cell in unit.cells} - lost)
    return failed


def _foretell(
    run: RunFolder, units: Sequence[Unit], sizes: Preset, config: StudyOptions, console: Console
) -> None:
    """Say what is left to do and how long that takes, by what this very run has measured so far."""
    from vidphys.experiments.costs import known_costs
    from vidphys.experiments.forecast import forecast

    left = [unit for unit in units if not all(run.is_done(part) for part in unit.parts)]
    known = known_costs([run.path], config.device)
    found = forecast(left, config.preset, sizes, known, config.engine)
    if found.seconds and found.wall(config.workers) > LONG_SECONDS:
        console.note(found.sentence(config.workers))


def measured(run: RunFolder, units: Sequence[Unit]) -> str:
    """How many cells have all their seeds, and what became of the others, in words."""
    left: dict[str, list[str]] = {}
    cells = dict.fromkeys(cell for unit in units for cell in unit.cells)
    reasons = {entry["cell"]: entry["reason"] for entry in run.manifest()["skipped"]}
    for unit in units:
        for cell, part in zip(unit.cells, unit.parts, strict=True):
            if not run.is_done(part) and cell not in left.get(SKIPPED, ()):
                skipped = reasons.get(f"{unit.table}/{cell}", "").startswith(SKIPPED)
                left.setdefault(SKIPPED if skipped else "failed", []).append(cell)
    gone = {cell for some in left.values() for cell in some}
    count = len(cells) - len(gone)
    words = f"{count} of {len(cells)} cells" if gone else f"{count} cells"
    if SKIPPED in left:
        rungs = len({cell.partition("/")[0] for cell in left[SKIPPED]})
        words += f"; {rungs} rung{'s' * (rungs > 1)} skipped: no weights"
    return words + (f"; {len(set(left['failed']))} failed" if "failed" in left else "")
