"""``vidphys trade``: speed against accuracy on this machine, and choosing from it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from vidphys.cli.console import Console
from vidphys.devices import prepare_device
from vidphys.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vidphys.points.point import Point


@dataclass(frozen=True)
class TradeConfig:
    """Measure speed against accuracy on this machine, choose from what was measured, compare.

    Example: vidphys trade --out runs/trade && vidphys trade --pick "inversion_nmse<=0.02"

    Fronts are measured one after the other, in this process: other work beside them would spoil the
    times, and another machine has others. So there are no workers and no engine.

    Args:
        out: the run folder; with pick or compare, where the measured points lie. The same command
            again goes on where it was.
        fronts: what is measured: rollouts, learned, forces, drawing, encoders, runtimes, readouts,
            training, pipeline; all if none is named.
        preset: how much is measured; quick takes about 90 s of one core, standard ten minutes.
        pick: a bound on a cost or an error, such as "inversion_nmse<=0.02" or "ms_per_clip<=20":
            the cheapest, or the most accurate, measured point within it.
        task: choose only among tasks whose name has this in it.
        save: write what was chosen to this profile file, for a verb's --profile.
        compare: an older run folder or profile; exit 1 if a front has moved back since, by more
            than 5 % in time or 2 % in error.
        threads: how many torch uses; with 1 on a CPU the time of the process counts, else the wall
            clock.
        weights: folder of encoders' weights; else VIDPHYS_WEIGHTS, else the user's cache.
        encoders: which are measured beside ours and those of installed packages, as timm:NAME,
            hf:FOLDER or package.module:factory.
        seed: of all random numbers.
        device: where networks run.
        overwrite: give up another run that lies in the folder.
        quiet: print nothing but the result.
    """

    out: Path = Path("runs/trade")
    fronts: tuple[str, ...] = ()
    preset: Literal["quick", "standard"] = "quick"
    pick: str | None = None
    task: str = ""
    save: Path | None = None
    compare: Path | None = None
    threads: int = 1
    weights: Path | None = None
    encoders: tuple[str, ...] = ()
    seed: int = 0
    device: Literal["cpu", "cuda"] = "cpu"
    overwrite: bool = False
    quiet: bool = False


def trade(config: TradeConfig) -> int:
    """Measure; or choose from what was measured, or compare it.

    Returns:
        0; 1 if a front has moved back, or no measured point is within the bound.

    Raises:
        InputError: options that exclude each other, an unknown front or quantity, or no points.
    """
    if config.pick is not None and config.compare is not None:
        raise InputError("trade: --pick and --compare exclude each other; give one of them")
    if config.save is not None and config.pick is None:
        raise InputError("trade: --save goes with --pick only")
    if config.pick is not None:
        return _pick(config, config.pick)
    if config.compare is not None:
        return _compare(config, config.compare)
    return _measure(config)


def _measure(config: TradeConfig) -> int:
    import torch

    from encoders.frozen import ENCODERS, load_encoder
    from vidphys.runs.folder import RunFolder
    from vidphys.trade.context import SIZES
    from vidphys.trade.session import choose, measure_fronts, surroundings
    from viz.trade import write_trade

    prepare_device(config.device)
    if config.threads < 1:
        raise InputError(f"--threads {config.threads}: at least one is needed")
    torch.set_num_threads(config.threads)
    fronts, sizes = choose(config.fronts), SIZES[config.preset]
    for name in config.encoders:
        try:
            load_encoder(name, {}, config.weights, config.device)
        except ValueError as error:
            raise InputError(f"--encoders: {error}") from error
    encoders = tuple(dict.fromkeys((*ENCODERS.foreign(), *config.encoders)))
    settings = {
        "experiment": "trade",
        "preset": config.preset,
        "sizes": asdict(sizes),
        "cells": list(fronts),
        "seeds": [config.seed],
        "surroundings": surroundings(config.device),
        "encoders": list(encoders),
        "sources": ENCODERS.sources(*encoders),
    }
    with (
        RunFolder.at_work(config.out, settings, config.overwrite) as run,
        Console(config.quiet, len(fronts), "trade") as console,
    ):

        def told(front: str, done: int, total: int) -> None:
            console.stage((front, done, total))
            if done == total:
                console.done(0)

        where = config.device, config.weights
        points = measure_fronts(run, fronts, sizes, config.seed, *where, encoders, told)
        report = write_trade(run.path)
        console.result(
            f"{len(points)} points; profile {run.path / 'profile.json'}; report {report}"
        )
    return 0


def _pick(config: TradeConfig, text: str) -> int:
    from vidphys.points.pick import Bound, pick
    from vidphys.trade.profile import write_profile
    from vidphys.trade.session import load_points, surroundings_of

    choices = pick(_of_task(config, load_points(config.out)), Bound.parse(text))
    for choice in choices:
        print(choice.sentence)
    met = [choice.point for choice in choices if choice.met]
    if config.save is not None and met:
        write_profile(config.save, surroundings_of(config.out), met)
        print(f"profile {config.save}: {len(met)} point(s)")
    return 0 if met else 1


def _of_task(config: TradeConfig, points: Sequence[Point]) -> list[Point]:
    found = [point for point in points if config.task in f"{point.front}: {point.task}"]
    if not found:
        raise InputError(f"--task {config.task!r}: no measured task has this in its name")
    return found


def _compare(config: TradeConfig, old: Path) -> int:
    from vidphys.points.pareto import by_task
    from vidphys.trade.compare import compare
    from vidphys.trade.session import load_points

    now = by_task(_of_task(config, load_points(config.out)))
    changes = []
    for task, before in by_task(load_points(old)).items():
        if task in now:
            changes += compare(before, now[task])
    if not changes:
        raise InputError(f"trade: {old} and {config.out} have no task in common")
    back = [change for change in changes if change.moved_back]
    for change in back:
        print(f"moved back: {change.sentence}")
    print(f"{len(changes)} points of older fronts, {len(back)} moved back")
    return 1 if back else 0
