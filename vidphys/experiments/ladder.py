"""The grounding ladder: the same question to the same heads, from the oracle down to pixels.

It is a table whose cells are ``rung/head``. A worker does one rung and seed in one go, so that its
heads share one perception.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from dynamics import HEADS, Head, Rollout, to_config
from encoders.frozen import ENCODERS
from renderers.worlds import PALETTE
from vidphys.experiments.core.bars import rows_of
from vidphys.experiments.core.cell import Cell, CellTask, Table, Unit
from vidphys.experiments.core.oracle import (
    OLDEST,
    held_out_question,
    score_oracle,
    true_segments,
)
from vidphys.experiments.core.question import Question
from vidphys.experiments.core.scoring import score_lost
from vidphys.experiments.core.showcase import write_showcase
from vidphys.experiments.core.trained import Training, train_cell
from vidphys.experiments.pixels.momentum import MOMENTUM, MomentumReadout
from vidphys.experiments.pixels.pixel_cell import TWINS, PixelCell, Scored
from vidphys.experiments.pixels.seen import Perceived, pixel_scene
from vidphys.perception.base import Grounding
from vidphys.perception.catalogue import ORACLE, ORACLES, RUNGS, rung_of
from vidphys.presets import OracleSizes
from vidphys.runs import checkpoint
from vidphys.scenes import SCENES, Scene, gravity
from vidphys.scenes.langevin import BathScene

NAME = "ladder"
ALL_HEADS = (
    "factored",
    "unstructured",
    "factored-radial",
    "factored-learned-kinetic",
    "symplectic",
)
ALL = "all"
FULL = (ORACLE.name, "renderer")  # rungs on which every head is compared


def oracle_scene() -> Scene:
    """Three bodies under gravity, by the headline generator."""
    return gravity("gaussian")


@dataclass(frozen=True)
class OracleCell:
    """A cell that trains a head on true states of a scene and starts it from one.

    Args:
        head: name in ``dynamics.HEADS``.
        scene: what is simulated.
        grounding: says on how many trajectories, and how old their starts are.
    """

    head: str
    scene: Callable[[], Scene] = oracle_scene
    grounding: Grounding = ORACLE

    @property
    def training(self) -> Training:
        """As the preset has it, but for what the rung is set to."""
        told = self.grounding.settings
        trajectories, oldest = told["trajectories"], told["oldest"]

        def sizes(usual: OracleSizes) -> OracleSizes:
            return usual if trajectories is None else replace(usual, trajectories=trajectories)

        examples = true_segments if oldest is None else partial(true_segments, oldest=oldest)
        return Training(sizes, examples=examples)

    def __call__(self, task: CellTask) -> None:
        scene, done, rung = self.scene(), set(), self.grounding
        told = {"grounding": rung.name, "supervision": rung.supervision, "knows": rung.knows}
        try:
            for seed, trained, recorder in train_cell(
                task, self.head, HEADS[self.head], scene, self.training, **told
            ):
                asked = partial(held_out_question, scene, task.sizes.held_out, seed)
                question = task.kept.once("question", seed, asked)
                rolled = score_oracle(recorder, trained, question)
                _keep(self.head, trained, question, task.folder)
                _show(task, seed, trained, question, rolled)
                done.add(seed)
        except FloatingPointError:
            pass  # counted below
        for recorder in task.recorders:
            if recorder.origin.seed not in done:
                score_lost(recorder, task.sizes.held_out)


@dataclass(frozen=True)
class RungCell(PixelCell):
    """One head on a rung's perception, under both readouts; what was trained is kept."""

    readouts: Sequence[MomentumReadout] = tuple(MOMENTUM.values())

    def part(self, head: str, readout: MomentumReadout) -> str | None:
        return None

    def fit_folder(self, task: CellTask, seed: int, head: str) -> Path | None:
        if task.folder is None or self.grounding.joint:
            return task.folder
        return task.folder.with_name(f"{self.grounding.name}-s{seed}")  # for all heads

    def folder(self, task: CellTask, seed: int, head: str, readout: MomentumReadout) -> Path | None:
        return None if task.folder is None else task.folder / readout.name

    def also(
        self, task: CellTask, seed: int, head: str, scored: Sequence[Scored], perceived: Perceived
    ) -> None:
        for one in scored:
            _keep(head, one.head, one.question, one.folder)
        for best in scored[-1:]:  # the last readout is the better one
            _show(task, seed, best.head, best.question, best.rolled, perceived)


def _keep(name: str, head: Head, question: Question, folder: Path | None) -> None:
    if folder is not None:
        terms, bodies = to_config(HEADS[name]), question.scene.bodies
        meta = {"step": 0, "terms": terms, "bodies": bodies, "dt": head.dt}
        checkpoint.save(folder / "head.json", dict(head.state_dict()), meta)


def _show(
    task: CellTask,
    seed: int,
    head: Head,
    question: Question,
    rolled: Rollout,
    perceived: Perceived | None = None,
) -> None:
    """Keep the arrays of a cell's recording."""
    if task.showcase is not None and seed == task.shown:
        meta = {"cell": task.cell, "seed": str(seed)}
        seen = (
            () if perceived is None else (perceived.seen.test, perceived.test, perceived.attention)
        )
        write_showcase(task.showcase, head, question, rolled, meta, *seen)


class Rungs(Mapping[str, Cell]):
    """The cells ``rung/head``: of any rung and head by name, and all that are compared in order."""

    def __getitem__(self, name: str) -> Cell:
        rung, head, scene = parts_of(name)
        HEADS[head]  # an unknown one is named before any work
        grounding = rung_of(rung)
        own = oracle_scene if grounding in ORACLES else pixel_scene
        of = SCENES[scene] if scene else own
        if why := why_not(grounding, of()):
            raise ValueError(f"scene {scene} cannot be asked on rung {rung}: {why}")
        if grounding in ORACLES:
            return OracleCell(head, of, grounding)
        return RungCell(grounding, (head,), of)

    def __iter__(self) -> Iterator[str]:
        return iter(cells_of())

    def __len__(self) -> int:
        return len(cells_of())


CELLS = Rungs()


def parts_of(cell: str) -> tuple[str, str, str]:
    """Rung, head and scene of ``rung/head@scene``; no scene means the study's own."""
    rung, _, rest = cell.partition("/")
    head, _, scene = rest.partition("@")
    return rung, head, scene


def why_not(rung: Grounding, scene: Scene) -> str:
    """Why a rung cannot be asked about a scene; empty where it can."""
    if isinstance(scene, BathScene):
        return "its bath makes another truth of every rollout; `vidphys reproduce thermostat` asks"
    if rung in ORACLES:
        return ""
    if scene.space != 2:
        return f"it has {scene.space} dimension(s), and pictures show a plane"
    if scene.box is not None:
        return "its bodies leave a periodic box at one side and come in at the other"
    if rung.world == "rgb" and scene.bodies > len(PALETTE):
        return f"it has {scene.bodies} bodies, and there are {len(PALETTE)} colours"
    return ""


def sources_of(cells: Sequence[str]) -> dict[str, str]:
    """Where the parts of cells come from that are not ours, for ``run.json``."""
    found: dict[str, str] = {}
    for rung, head, scene in map(parts_of, cells):
        found |= HEADS.sources(head) | (SCENES.sources(scene) if scene else {})
        found |= (RUNGS if rung in RUNGS else ENCODERS).sources(rung)
    return found


def cells_of(
    names: Sequence[str] = (), heads: Sequence[str] = (), scene: str = ""
) -> tuple[str, ...]:
    """Cells by name.

    Args:
        names: rungs or ``rung/head``; ``all`` is every rung and its variants, none named every
            rung alone.
        heads: of every rung named without one, instead of the rung's own.
        scene: that they are asked about, in place of the study's own.

    Raises:
        UnknownName: a rung, a head or a scene; the nearest spelling is given.
        ValueError: a rung cannot show the scene.
    """
    at = f"@{scene}" if scene else ""
    found: list[str] = []
    filmed = SCENES[scene]() if scene else pixel_scene()
    every = ALL in names
    listed = [name for name, g in RUNGS.items() if (every or not g.of) and not why_not(g, filmed)]
    wanted = [name for name in names if name != ALL]
    for name in dict.fromkeys([*(listed if every or not names else ()), *wanted]):
        rung, _, head = name.partition("/")
        own = ALL_HEADS if rung in FULL else TWINS
        found += [f"{rung}/{h}{at}" for h in ([head] if head else heads or own)]
    if wanted or heads or scene:
        for name in found:
            CELLS[name]
    return tuple(dict.fromkeys(found))


@dataclass(frozen=True)
class Ladder(Table):
    """A table of which a worker does a rung and a seed in one go."""

    def units(self, cells: Sequence[str], seeds: tuple[int, ...]) -> list[Unit]:
        """Seeds outermost: an interrupted ladder has whole ladders of fewer seeds."""
        rungs: dict[str, list[str]] = {}
        for cell in cells:
            rungs.setdefault(cell.partition("/")[0], []).append(cell)
        return [
            Unit(
                self.name,
                tuple(together),
                (seed,),
                tuple(f"{cell.replace('/', '-')}-s{seed}" for cell in together),
            )
            for seed in seeds
            for together in rungs.values()
        ]


LADDER = Ladder.told(
    NAME,
    cells=CELLS,
    settings={
        "scene": oracle_scene().settings,
        "oldest_training_start_steps": OLDEST,
        "pixel_scene": pixel_scene().settings,
        "heads": {name: to_config(HEADS[name]) for name in HEADS.ours()},
        "references": {row.cell: float(row.paper) for row in rows_of(NAME) if row.paper},
    },
    apart=True,
)
