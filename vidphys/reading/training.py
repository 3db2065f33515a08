"""``vidphys train`` from clips to a pipeline: features, readouts, tracks, dynamics.

Features are cached, readouts and heads leave checkpoints, and what lies between is computed from
these again: an interrupted training goes on where it was and ends as it would have ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch

from binders.tracks import Tracks
from dynamics import HEADS
from encoders.features import FeatureMap
from encoders.store import FeatureStore
from readouts.kinds import MapShape
from vidphys.data.charts import chart_of
from vidphys.data.clip_files import Dataset
from vidphys.data.extraction import Axes, StoredDtype, extract
from vidphys.data.splits import AUTO, Split
from vidphys.data.video import ClipSelection, open_video
from vidphys.reading.clip_dynamics import Dynamics, Followed, fit_head, sample, terms_of
from vidphys.reading.familiar import familiar_of
from vidphys.reading.pipeline import Pipeline
from vidphys.reading.reader import Layer, LoadedEncoder, Reader, steady
from vidphys.reading.seen_clips import SeenClip, Stage, labelled, split_of
from vidphys.training.candidates import (
    Examples,
    Grid,
    TrainedReadout,
    best_of,
    train_grid,
)
from vidphys.training.learner import OnNan
from vidphys.training.readouts import ReadoutSettings


@dataclass(frozen=True)
class TrainSettings:
    """How a data set is trained on.

    Args:
        readout: of the readouts' training.
        grid: the readouts that are tried.
        mirrors: read the clips that are scored, and later ones, with their mirror images.
        selection: frames of each clip.
        share: of the clips (of a single clip's frames) that is trained on.
        head_steps: of each head's optimiser.
        heads: of :data:`dynamics.HEADS`, trained beside the two that the scene asks for.
        seed: of batch orders and heads.
        on_nan: of the heads; see :class:`vidphys.training.learner.FitSettings`.
        device: where readouts and heads are trained; they come back from there.
        split_by: see :func:`vidphys.reading.seen_clips.split_of`.
        store_dtype: of the stored features.
    """

    readout: ReadoutSettings
    grid: Grid
    mirrors: bool = True
    selection: ClipSelection = ClipSelection()
    share: float = 0.6
    head_steps: int = 400
    heads: tuple[str, ...] = ()
    seed: int = 0
    on_nan: OnNan = "stop"
    device: str = "cpu"
    split_by: str = AUTO
    store_dtype: StoredDtype = "float16"


@dataclass(frozen=True)
class Perceived:
    """The clips of a data set as the best of many readouts sees them.

    Args:
        clips: of the data set.
        splits: of each layer's feature frames.
        readouts: all that were tried.
        chosen: the one that was best on what was held out.
        reader: with the chosen one.
        tracks: of each clip, as it is seen, world units.
    """

    clips: tuple[SeenClip, ...]
    splits: Mapping[Layer, Split]
    readouts: tuple[TrainedReadout, ...]
    chosen: TrainedReadout
    reader: Reader
    tracks: tuple[Tracks, ...]

    @property
    def split(self) -> Split:
        """For the chosen readout's layer."""
        return self.splits[self.chosen.candidate.layer]

    def followed(self, clip: int) -> Followed:
        """A clip's track without the drift of its camera, and its law."""
        camera = self.reader.half_extent * self.clips[clip].camera
        return Followed(steady(self.tracks[clip], camera), self.clips[clip].law)


def perceive(
    clips: tuple[SeenClip, ...],
    dataset: Dataset,
    encoders: Mapping[Layer, LoadedEncoder],
    store: FeatureStore,
    settings: TrainSettings,
    folder: Path | None,
    stage: Stage,
) -> Perceived:
    """Train all readouts, each layer's in one pass, and read every clip with the best.

    Those that something is asked about are read closely; see :meth:`Reader.closely`.

    Args:
        clips: from :func:`see`.
        dataset, encoders, store, settings, stage: see there.
        folder: for checkpoints.

    Raises:
        InputError: too few clips or frames.
    """
    readouts: list[TrainedReadout] = []
    splits, bodies = {}, clips[0].labels.positions.shape[2]
    for layer, encoder in encoders.items():
        each = encoder.network.frames_per_feature
        split = splits[layer] = split_of(clips, layer, each, settings.share, settings.split_by)
        examples = Examples(
            *(labelled(clips, layer, some, each, folder) for some in (split.train, split.held_out))
        )
        shape = MapShape(examples.train.values.shape[1], examples.train.grid, bodies, each)
        name = "readouts" if layer is None else f"readouts, layer {layer}"
        how = settings.readout, settings.seed, folder, stage(name)
        readouts += train_grid(settings.grid, layer, shape, examples, *how, settings.device)
    chosen = best_of(settings.grid.kind, readouts)
    layer = chosen.candidate.layer
    reader = Reader(
        encoders[layer],
        chosen.module,
        bodies,
        dataset.half_extent,
        clips[0].follows_camera,
        settings.selection.stride,
        settings.selection.side,
        settings.mirrors,
    )
    tracks = tuple(
        reader.tracks(clip.features[layer], clip.labels.times)
        if asked is None
        else _closely(reader, clip, store, settings, stage)
        for clip, asked in zip(clips, splits[layer].asked, strict=True)
    )
    return Perceived(clips, splits, tuple(readouts), chosen, reader, tracks)


def _closely(
    reader: Reader, clip: SeenClip, store: FeatureStore, settings: TrainSettings, stage: Stage
) -> Tracks:
    video, network = open_video(clip.file.path, settings.selection), reader.encoder.network

    def see(axes: Axes) -> FeatureMap:
        flipped = "".join("xy"[-1 - axis] for axis in axes)
        name = f"{clip.file.path.name}: features" + (flipped and f", mirrored in {flipped}")
        return extract(video, network, store, settings.store_dtype, stage(name), axes).features

    return reader.closely(see, clip.labels.times)


def understand(
    perceived: Perceived,
    friction: bool,
    settings: TrainSettings,
    folder: Path | None,
    stage: Stage,
) -> Pipeline:
    """Fit both heads to the tracks of what may be known.

    Args:
        perceived: see there.
        friction: whether the factored head has any.
        settings: see :class:`TrainSettings`.
        folder: for checkpoints.
        stage: gives a stage's progress its name.

    Raises:
        InputError: clips too short to show momentum, or in which nothing moves.
    """
    followed = [perceived.followed(k) for k in range(len(perceived.clips))]
    known = perceived.split.known
    places = [c.track.positions[0, :end] for c, end in zip(followed, known, strict=True)]
    chart = chart_of(torch.cat(places))
    samples = sample(followed, known, chart)
    terms = terms_of(chart, perceived.reader.bodies, friction)
    terms |= {name: HEADS[name] for name in settings.heads}
    heads = {}
    for name, each in terms.items():
        save_to = None if folder is None else folder / name
        how = settings.head_steps, settings.seed, save_to, stage(f"{name} head"), settings.on_nan
        heads[name] = fit_head(each, samples, chart, *how, settings.device)
    dynamics = Dynamics(chart, samples.interval, terms, heads)
    layer = perceived.chosen.candidate.layer
    maps = [clip.features[layer].values[0] for clip in perceived.clips]
    familiar = familiar_of(maps, perceived.split, followed, dynamics)
    return Pipeline(perceived.reader, perceived.chosen.candidate.recipe, dynamics, familiar)
