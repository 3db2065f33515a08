"""What ``ladder`` and ``reproduce`` share: their options, and how their units of work are run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vidphys.cli.units import SKIPPED, EngineOptions, run_units
from vidphys.devices import prepare_device
from vidphys.errors import InputError
from vidphys.presets import Preset, preset

if TYPE_CHECKING:
    from vidphys.cli.console import Console
    from vidphys.experiments.core.cell import Unit
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.units import WorkUnit

LONG_SECONDS = 60.0  # of a run that is worth a word on how long it takes


@dataclass(frozen=True, kw_only=True)
class StudyOptions(EngineOptions):
    """How large a study is, and how it is computed.

    Args:
        preset: sizes and seeds; quick is minutes on two cores.
        seed: the first seed. Those below 100 are for development; figures are reported from 100.
        seeds: how many from there on, instead of the preset's number.
        profile: settings for this verb, from a file that `vidphys trade --pick ... --save` wrote.
        device: where models are trained and rolled; references and scores are on the CPU.
        measured: run folders whose units' times and memory are taken; where there is none our
            times, of the preset quick on one core, multiplied by how many times as long this
            machine takes for half a second of such work now. What was measured in another preset is
            scaled as cells are that are known in both, else by the part of the work that grows
            most: an upper bound.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    preset: Literal["quick", "standard", "paper"] = "quick"
    seed: int = 0
    seeds: int | None = None
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    measured: tuple[Path, ...] = ()
    overwrite: bool = False
    quiet: bool = False

    def sizes(self) -> tuple[Preset, range]:
        """The preset, and the seeds.

        Raises:
            InputError: no worker or seed, or a device that is not there.
        """
        prepare_device(self.device)
        self.check_workers()
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


def run_study(
    run: RunFolder, units: Sequence[Unit], sizes: Preset, config: StudyOptions, console: Console
) -> int:
    """Do every unit of a study; one that fails is named in the run folder and the others go on.

    Returns:
        How many failed. A unit whose encoder's weights are not on this machine is skipped, which
        is no failure.
    """
    from vidphys.experiments.study import run_unit

    work = work_units(run, units, sizes, config)
    _foretell(run, units, sizes, config, console)
    return run_units(run, run_unit, work, config, console)


def work_units(
    run: RunFolder, units: Sequence[Unit], sizes: Preset, config: StudyOptions
) -> list[WorkUnit]:
    """The units as every engine takes them; each needs the memory that it was seen to take."""
    from vidphys.experiments.costs import MEASURED, Costs
    from vidphys.runs.needs import Needs, card_share
    from vidphys.runs.units import WorkUnit

    known = Costs.of_runs([*config.measured, run.path], config.device)
    share = card_share(config.workers, config.address) if config.device == "cuda" else 0.0
    work = []
    for unit in units:
        cost = known.of(unit, config.preset, sizes)
        memory = cost[0].peak_bytes if cost is not None and cost[1] == MEASURED else 0
        cells = (f"{unit.table}/{cell}" for cell in unit.cells)
        parts = dict(zip(unit.parts, cells, strict=True))
        rung = unit.cells[0].partition("/")[0]
        needs = Needs(memory=memory, gpu=share)
        work.append(WorkUnit(parts, rung, (unit, sizes, config.device), needs))
    return work


def _foretell(
    run: RunFolder, units: Sequence[Unit], sizes: Preset, config: StudyOptions, console: Console
) -> None:
    """Say what is left to do and how long that takes, by what is measured of it so far."""
    from vidphys.experiments.costs import known_costs, pace_here
    from vidphys.experiments.forecast import forecast

    left = [unit for unit in units if not all(run.is_done(part) for part in unit.parts)]
    if config.quiet or not left:
        return
    pace = pace_here(config.workers)
    known = known_costs([*config.measured, run.path], config.device, pace)
    found = forecast(left, config.preset, sizes, known, config.engine, pace)
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
