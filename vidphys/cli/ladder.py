"""``vidphys ladder``: the grounding ladder, from the oracle down to anonymous pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vidphys.cli.console import Console
from vidphys.cli.profiles import with_profile
from vidphys.cli.study import StudyOptions, measured, option, run_study

if TYPE_CHECKING:
    from vidphys.runs.folder import RunFolder


@dataclass(frozen=True)
class LadderConfig(StudyOptions):
    """Run the grounding ladder and write its report and recordings.

    Example: vidphys ladder --preset quick --cells oracle renderer/factored --out runs/mine

    Example: vidphys ladder --preset standard --seed 100 --seeds 3 --out runs/confirmed

    Args:
        out: the run folder; the same command again goes on where it was.
        cells: rungs, or rung/head, where a rung is also any encoder by name or as
            package.module:factory; `all` is every rung and its variants, none named every rung.
        heads: heads of every named rung, instead of the rung's own.
        scene: what is asked about, by a name of `vidphys parts` or package.module:factory; the
            study's own where none is named.
    """

    out: Path = Path("runs/ladder")
    cells: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    scene: str = ""


def ladder(config: LadderConfig) -> int:
    """Run what is left of the ladder, then write tables, report and recordings.

    Returns:
        0, or 1 if a unit of work failed; what others found is kept.

    Raises:
        InputError: no worker or seed, a device that is not there, an unknown rung or head, or
            another run in the folder.
    """
    config = with_profile(config, "ladder")
    from dynamics import HEADS
    from vidphys.experiments.ladder import LADDER, cells_of, sources_of
    from vidphys.experiments.study import settings_of, units_of
    from vidphys.runs.folder import RunFolder
    from vidphys.seeding import told

    sizes, seeds = config.sizes()
    config.check_engine()
    for head in config.heads:
        with option(f"--heads {head}"):
            HEADS[head]
    with option("--cells, --scene"):
        cells = cells_of(config.cells, config.heads, config.scene)
        units = units_of([LADDER], seeds, cells)
    settings = settings_of("ladder", config.preset, sizes, units, [LADDER])
    settings["sources"] = sources_of(cells)
    with (
        RunFolder.at_work(config.out, settings, config.overwrite, threads=1) as run,
        Console(config.quiet, len(units), "ladder") as console,
    ):
        failed = run_study(run, units, sizes, config, console)
        run.join()
        report = publish(run, console)
        console.result(f"{measured(run, units)}; seeds {told(seeds)}; report: {report}")
    return 1 if failed else 0


def publish(run: RunFolder, console: Console) -> Path:
    """Draw the recordings and write the report from what lies in the run folder."""
    from vidphys.cli.playing import write_play
    from viz.recording import write_recording
    from viz.report import write_report
    from viz.showcase import read_showcase
    from viz.story import story

    for file in sorted((run.path / "showcase").glob("*.safetensors")):
        with console.drawing(f"the recording of {file.stem}"):
            arrays, meta = read_showcase(file)
            path = run.path / "recordings" / f"{file.stem}.rrd"
            write_recording(arrays, story(run.path, meta), path)
    with console.drawing("the law to play with"):
        write_play(run.path)
    return write_report(run.path)
