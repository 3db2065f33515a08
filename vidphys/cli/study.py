"""What ``ladder`` and ``reproduce`` share: their options, and how their units of work are run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from vidphys.devices import check_cuda
from vidphys.errors import InputError
from vidphys.presets import Preset, preset

if TYPE_CHECKING:
    from vidphys.cli.console import Console
    from vidphys.runs.folder import RunFolder


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """How large a study is, and how it is computed.

    Args:
        preset: sizes and seeds; quick is minutes on two cores.
        seeds: number of seeds, instead of the preset's.
        workers: processes.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        device: where to train.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    preset: Literal["quick", "standard", "paper"] = "quick"
    seeds: int | None = None
    workers: int = 2
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False

    def sizes(self) -> tuple[Preset, int]:
        """The preset, and the number of seeds.

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
        return sizes, seeds


def run_units(
    run: RunFolder,
    work: Callable[..., None],
    tasks: Sequence[tuple[Any, ...]],
    names: Sequence[str],
    workers: int,
    console: Console,
) -> int:
    """Run every task; one that fails is named in the run folder and the others go on.

    Args:
        work, tasks: as :func:`vidphys.runs.pool.run_all` takes them.
        names: of the tasks, for who reads why one has no result.

    Returns:
        How many failed. A unit whose encoder's weights are not on this machine is skipped, which
        is no failure.
    """
    from dynamics.compiled.ahead import compile_ahead
    from encoders.release import WeightsMissing
    from vidphys.runs.pool import run_all

    if min(workers, len(tasks)) > 1:
        console.stage(("compiling", 0, 1))
        compile_ahead()
        console.stage(("compiling", 1, 1))
    failed = 0
    for index, error in run_all(work, list(tasks), workers, console.stage, console.done):
        absent = isinstance(error, WeightsMissing)
        failed += not absent
        word = "skipped" if absent else f"failed: {type(error).__name__}"
        run.skip(names[index], f"{word}: {error}")
        console.warn(f"{names[index]} {word}: {error}")
    return failed
