"""Where stages come from: a ladder's run, a fit, a diagnosis, a training with a clip, a scene."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import torch
from torch import Generator

from dynamics import Head, Parameters, PhaseState
from dynamics.potentials import PairPotential
from vidphys.errors import InputError
from vidphys.opened import Run, open_run
from vidphys.play.stage import AT_ONCE, Stage, View
from vidphys.scenes import SCENES, Scene
from vidphys.seeding import derive

TWIN = "unstructured"
PREFERRED = "oracle/factored"
IN_LADDER = "ladder/"  # before the names of cells in the settings of a run
FITTED = Path("checkpoints") / "heads" / "specified.json"
SPECIFICATION, TRACKS = "specification.json", "tracks.csv"
PATHS = 64  # of a heat bath, from one start


class Source(Protocol):
    """Where stages come from."""

    @property
    def names(self) -> list[str]:
        """Of all stages; the first is shown at first."""

    def stage(self, name: str) -> Stage:
        """One of them, by its name.

        Raises:
            InputError: there is no such stage, or its files are damaged.
        """


@dataclass(frozen=True)
class SceneSource:
    """A scene by its name: its exact law, rolled from starts of its own."""

    names: list[str]
    episodes: int = AT_ONCE

    def stage(self, name: str) -> Stage:
        """See :class:`Source`."""
        _known(name, self.names)
        scene = SCENES[name]()
        if not isinstance(scene.law, Head):
            raise InputError(f"play: {name}: the law of this scene cannot be stepped")
        start, params = _starts(scene, self.episodes, 0)
        notes = ("The exact law of the scene. Grey: by the scene's own step.",)
        return Stage(name, scene.law, start, params, scene.dt, scene, notes=notes)


@dataclass(frozen=True)
class LadderSource:
    """The heads that a ladder trained, each with its twin and the truth."""

    run: Run
    names: list[str]
    seeds: dict[str, tuple[str, int]] = field(repr=False)  # of a name, the cell and the seed
    episodes: int = AT_ONCE

    @classmethod
    def of(cls, run: Run, episodes: int = AT_ONCE) -> LadderSource:
        """Of a run.

        Raises:
            InputError: it kept no head.
        """
        settings, kept = run.settings, [part for part in run.parts if part.endswith("/head")]
        seeds, found = settings.get("seeds", []), {}
        for seed in seeds:
            for cell in (name.removeprefix(IN_LADDER) for name in settings.get("cells", [])):
                if any(part.startswith(f"{cell.replace('/', '-')}-s{seed}/") for part in kept):
                    found[cell if len(seeds) == 1 else f"{cell}, seed {seed}"] = (cell, seed)
        if not found:
            raise InputError(
                f"play: {run.path} kept no model to roll; give the folder of a ladder, a training, "
                "a fit or a diagnosis, or the name of a scene"
            )
        names = sorted(found, key=lambda name: (found[name][0] != PREFERRED, name.lower()))
        return cls(run, names, found, episodes)

    def stage(self, name: str) -> Stage:
        """See :class:`Source`."""
        from vidphys.experiments.core.oracle import held_out_question
        from vidphys.experiments.ladder import CELLS, OracleCell, parts_of

        _known(name, self.names)
        cell, seed = self.seeds[name]
        asked, learned = CELLS[cell], self.run.head(cell, seed).requires_grad_(False)
        scene = asked.scene()  # type: ignore[attr-defined]
        held_out, notes = self.episodes, tuple[str, ...]()
        if isinstance(asked, OracleCell):
            held_out = self.run.settings["sizes"]["oracle"]["held_out"]
        question = held_out_question(scene, held_out, seed)
        more = max(0, self.episodes - held_out)
        start, params = question.start[: self.episodes], question.params[: self.episodes]
        if more:
            new, law = _starts(scene, more, seed)
            start = PhaseState(torch.cat([start.q, new.q]), torch.cat([start.p, new.p]))
            params = Parameters.cat([params, law])
            notes = (f"Episodes from {held_out} on were made for this page.",)
        rung, own, at = parts_of(cell)
        twin = None
        other = f"{rung}/{TWIN}" + (f"@{at}" if at else "")
        if own != TWIN and (other, seed) in self.seeds.values():
            found = self.run.head(other, seed).requires_grad_(False)
            twin = found, question.step_of(found)
        if not isinstance(asked, OracleCell):
            notes = (*notes, "Rolled from true states: what this rung sees is not asked here.")
        start, params = start.map(torch.Tensor.float), params.map(torch.Tensor.float)
        dt = question.step_of(learned)
        stage = Stage(name, learned, start, params, dt, scene, twin=twin, notes=notes)
        return stage.compiled()


@dataclass(frozen=True)
class FitSource:
    """A fit, or what a diagnosis specified, rolled on from the end of its tracks."""

    path: Path
    table: Path
    names: list[str] = field(default_factory=lambda: ["tracks/specified"])

    def stage(self, name: str) -> Stage:
        """See :class:`Source`."""
        from vidphys.diagnose.recordings.flat import laid
        from vidphys.diagnose.recordings.tables import read_tracks
        from vidphys.reading.fitted import load_fitted
        from vidphys.shooting.step import model_step

        _known(name, self.names)
        if not self.table.is_file():
            raise InputError(
                f"play: {self.path} kept no tracks to start from; give the table as well"
            )
        motion = read_tracks(self.table).motion
        fitted = load_fitted(self.path) if (self.path / FITTED).is_file() else None
        if fitted is None:
            from vidphys.diagnose.explanations.specification import read_specification
            from vidphys.reading.specified import at_specified

            fitted = at_specified(*read_specification(self.path / SPECIFICATION), motion)
        motion = laid(motion.cut(*motion.shown()), fitted.plane)
        start, law = fitted.last(motion), fitted.law(motion)
        if fitted.kicked:
            paths = torch.zeros(PATHS, dtype=torch.long)
            start, law = start[paths], law[paths]
        units = fitted.units
        view = View(units.length, units.seconds, torch.from_numpy(fitted.origin))
        coupled = any(isinstance(part, PairPotential) for part in fitted.head.modules())
        told = "From the last frame of the tracks on. Grey: the law that held."
        dt = model_step(fitted.interval / units.seconds)[0]
        stage = Stage(
            name,
            fitted.head.requires_grad_(False),
            start,
            law,
            dt,
            view=view,
            coupled=coupled,
            seen=fitted.seen,
            notes=(told,),
        )
        return stage.compiled()


@dataclass(frozen=True)
class TrainingSource:
    """The models of a training, rolled on from the last frame of a clip."""

    run: Run
    clip: Path
    weights: Path | None
    names: list[str]

    @classmethod
    def of(cls, run: Run, clip: Path | None, weights: Path | None) -> TrainingSource:
        """Of a run and a clip.

        Raises:
            InputError: no clip was given.
        """
        if clip is None:
            raise InputError(f"play: {run.path}: a training rolls what it sees; give a clip")
        from vidphys.reading.clip_dynamics import FACTORED

        heads = run.pipeline(weights).dynamics.heads
        return cls(run, clip, weights, sorted(heads, key=lambda name: (name != FACTORED, name)))

    def stage(self, name: str) -> Stage:
        """See :class:`Source`."""
        from vidphys.data.charts import Plane
        from vidphys.data.dataset import clip_file
        from vidphys.data.video import ClipSelection, open_video, require_frames

        _known(name, self.names)
        pipeline = self.run.pipeline(self.weights)
        reader, dynamics = pipeline.reader, pipeline.dynamics
        selection = ClipSelection(0, None, reader.stride, reader.side, None)
        video = open_video(self.clip, selection)
        require_frames(video)
        law = clip_file(self.clip).law(reader.bodies)
        read = pipeline(video.frames, video.times, law, dynamics.dt, name)
        chart = None if isinstance(dynamics.chart, Plane) else dynamics.chart
        twin = dynamics.heads[TWIN].requires_grad_(False) if name != TWIN else None
        start, params = read.state.map(torch.Tensor.float), read.law.map(torch.Tensor.float)
        head = dynamics.heads[name].requires_grad_(False)
        told = f"From the last frame of {self.clip.name} on. Grey: the law that held."
        stage = Stage(
            name,
            head,
            start,
            params,
            dynamics.dt,
            twin=None if twin is None else (twin, dynamics.dt),
            view=View(chart=chart),
            notes=(told,),
        )
        return stage.compiled()


def source_of(
    what: str,
    given: Path | None = None,
    weights: Path | None = None,
    episodes: int | None = None,
) -> Source:
    """What can be played with under a name or in a folder.

    Args:
        what: the folder of a run, or the name of a scene.
        given: the clip that a training rolls on, or the table of a diagnosis that kept no tracks.
        weights: of a training's encoder.
        episodes: of a scene or a ladder, how many there are; :data:`AT_ONCE` by default.

    Raises:
        InputError: there is no such folder or scene, or nothing in it to roll.
    """
    path = Path(what)
    if not path.exists():
        if what in SCENES:
            _nothing(given)
            return SceneSource([what], episodes or AT_ONCE)
        near = difflib.get_close_matches(what, list(SCENES), n=1)
        guess = f"; did you mean the scene {near[0]}?" if near else ""
        raise InputError(
            f"play: {what}: no such folder{guess or '; the scenes are ' + ', '.join(SCENES)}"
        )
    if path.name == SPECIFICATION:
        path = path.parent
    run = open_run(path)
    fitted = (path / FITTED).is_file() or (path / SPECIFICATION).is_file()
    if episodes is not None and (run.has_pipeline or fitted):
        raise InputError("`episodes`: only a scene and a ladder have starts without number")
    if run.has_pipeline:
        return TrainingSource.of(run, given, weights)
    if fitted:
        return FitSource(path, given or path / TRACKS)
    _nothing(given)
    return LadderSource.of(run, episodes or AT_ONCE)


def _nothing(given: Path | None) -> None:
    if given is not None:
        raise InputError(
            f"play: {given}: only a training, a fit or a diagnosis goes on from a file"
        )


def _starts(scene: Scene, episodes: int, seed: int) -> tuple[PhaseState, Parameters]:
    return scene.sample(episodes, Generator().manual_seed(derive(seed, "play")))


def _known(name: str, names: list[str]) -> None:
    if name not in names:
        near = difflib.get_close_matches(name, names, n=1)
        guess = f"; did you mean {near[0]}?" if near else f"; there are {', '.join(names)}"
        raise InputError(f"play: no {name} here{guess}")
