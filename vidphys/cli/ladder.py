"""``vidphys ladder``: the grounding ladder, from the oracle down to anonymous pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from vidphys.cli.console import Console
from vidphys.cli.devices import check_cuda
from vidphys.cli.profiles import with_profile
from vidphys.errors import InputError


@dataclass(frozen=True)
class LadderConfig:
    """Run the grounding ladder and write its report and recordings.

    Example: vidphys ladder --preset quick --cells oracle renderer/factored --out runs/mine

    Args:
        out: the run folder; the same command again goes on where it was.
        preset: sizes and seeds; quick is minutes on two cores.
        cells: rungs, or rung/head; all if none is named.
        heads: heads of every named rung, instead of the rung's own.
        seeds: number of seeds, instead of the preset's.
        workers: processes.
        profile: take what it sets of this verb from a point that `vidphys trade --pick` chose.
        device: where to compute.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    out: Path = Path("runs/ladder")
    preset: Literal["quick", "standard", "paper"] = "quick"
    cells: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    seeds: int | None = None
    workers: int = 2
    profile: Path | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False


def ladder(config: LadderConfig) -> int:
    """Run what is left of the ladder, then write tables, report and recordings.

    Returns:
        0, or 1 if a unit of work failed; what others found is kept. A rung whose weights are not
        on this machine is skipped and said so; that is no failure.

    Raises:
        InputError: see :func:`vidphys.experiments.ladder.plan` and the run folder.
    """
    config = with_profile(config, "ladder")
    from encoders.release import WeightsMissing
    from vidphys.experiments.ladder import plan, run_unit, settings_of
    from vidphys.presets import preset
    from vidphys.runs.folder import RunFolder
    from vidphys.runs.pool import run_all

    check_device(config.device)
    if config.workers < 1:
        raise InputError(f"--workers {config.workers}: at least one process is needed")
    sizes = preset(config.preset)
    seeds = sizes.seeds if config.seeds is None else config.seeds
    asked = plan(config.cells, config.heads, seeds)
    run = RunFolder.open(config.out, settings_of(config.preset, sizes, asked), config.overwrite)
    with run.locked(), Console(config.quiet, len(asked.units), "ladder") as console:
        tasks = [(run.path, unit, sizes) for unit in asked.units]
        failures = run_all(run_unit, tasks, config.workers, console.stage, console.done)
        failed = 0
        for index, error in failures:
            unit = asked.units[index]
            absent = isinstance(error, WeightsMissing)
            failed += not absent
            word = "skipped" if absent else "failed"
            run.skip(f"{unit.grounding} seed {unit.seed}", f"{word}: {error}")
            console.warn(f"{unit.grounding} seed {unit.seed} {word}: {error}")
        run.join()
        report = publish(run)
        console.result(f"{len(asked.parts)} cells; report: {report}")
    return 1 if failed else 0


def publish(run) -> Path:  # noqa: ANN001 (RunFolder, imported late)
    """Draw the recordings and write the report from what lies in the run folder."""
    from viz.recording import write_recording
    from viz.report import write_report
    from viz.showcase import read_showcase

    for file in sorted((run.path / "showcase").glob("*.safetensors")):
        arrays, meta = read_showcase(file)
        write_recording(arrays, meta, run.path / "recordings" / f"{file.stem}.rrd")
    return write_report(run.path)


def check_device(device: str) -> None:
    """Refuse a device that is not there.

    Raises:
        InputError: CUDA is asked for and there is none, or the verb has no CUDA path.
    """
    check_cuda(device)
    if device == "cuda":
        raise InputError("--device cuda: the ladder computes on the CPU; use --device cpu")
