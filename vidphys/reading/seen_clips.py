"""The clips of a data set once their frames are not needed any more: labels and features."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from binders.base import Binder
from binders.tracks import Tracks
from dynamics import Parameters
from encoders.features import FeatureMap
from encoders.identity import LayeredEncoder
from encoders.store import FeatureStore
from vidphys.data.about import about_video
from vidphys.data.clip_files import ClipFile, Dataset
from vidphys.data.extraction import StoredDtype, extract, extract_layers
from vidphys.data.feature_frames import frame_targets
from vidphys.data.labelled import LabelledFrames, joined
from vidphys.data.labelled_clips import LabelledClip, read_clips
from vidphys.data.splits import (
    AUTO,
    TIME,
    Split,
    groups_of,
    refuse_leaks,
    roles_by_group,
    roles_by_name,
    split_clips,
    split_times,
)
from vidphys.data.video import ClipSelection, Video
from vidphys.errors import InputError
from vidphys.progress import Progress
from vidphys.reading.reader import Layer, LoadedEncoder

Stage = Callable[[str], Progress]
AT_ONCE = 64  # feature frames


@dataclass(frozen=True)
class SeenClip:
    """A clip of which only what is needed later is kept.

    Args:
        file: on disk.
        size: of its frames, (height, width).
        labels: what readouts are taught and all are judged by, normalised image units.
        camera: displacement of the background ``(t, 2)``, normalised image units.
        follows_camera: whether that was looked for.
        features: by layer, memory-mapped.
        about: how it was read, for the record.
    """

    file: ClipFile
    size: tuple[int, int]
    labels: Tracks
    camera: Tensor
    follows_camera: bool
    features: Mapping[Layer, FeatureMap]
    about: Mapping[str, Any]

    @property
    def law(self) -> Parameters:
        """That held, batch of one."""
        return self.file.law(self.labels.positions.shape[2])


def see(
    dataset: Dataset,
    encoders: Mapping[Layer, LoadedEncoder],
    store: FeatureStore,
    selection: ClipSelection,
    binder: Binder,
    stage: Stage,
    dtype: StoredDtype = "float16",
) -> tuple[SeenClip, ...]:
    """Labels and features of every clip; only one clip's frames are in memory at a time.

    Args:
        dataset: the clips.
        encoders: by layer.
        store: of the features.
        selection: frames of each clip.
        binder: follows the bodies where no table tells the positions.
        stage: gives a stage's progress its name.
        dtype: of the stored features.

    Raises:
        InputError: see :func:`vidphys.data.labelled_clips.read_clips`; bodies that no readout of
            single frames can tell apart; fewer frames than a feature frame of the encoder stands
            for.
    """
    if dataset.identical:
        raise InputError(
            "train: the bodies of this data set look alike, and a readout that sees frame by frame "
            "cannot keep them apart; render another world, or use the ladder's anonymous rungs"
        )
    seen = []
    several = len(dataset.files) > 1 and not dataset.labelled
    for clip in read_clips(dataset, selection, binder):
        if several and clip.tracks.positions.shape[2] > 1:
            raise InputError(
                "train: several clips of several bodies need labels beside them: following what "
                "moves does not tell which body of one clip is which of another"
            )
        _check_frames(clip, encoders)
        progress = stage(f"{clip.file.path.name}: features")
        features = _features(clip.video, encoders, store, dtype, progress)
        seen.append(
            SeenClip(
                clip.file,
                clip.video.size,
                clip.tracks,
                clip.camera,
                clip.follows_camera,
                features,
                about_video(clip.video),
            )
        )
    return tuple(seen)


def _features(
    video: Video,
    encoders: Mapping[Layer, LoadedEncoder],
    store: FeatureStore,
    dtype: StoredDtype,
    progress: Progress,
) -> dict[Layer, FeatureMap]:
    """Those of every layer, from one pass where one network has them all."""
    first = next(iter(encoders.values())).network
    names = {layer: encoder.network.identity.layer for layer, encoder in encoders.items()}
    if isinstance(first, LayeredEncoder) and set(names.values()) <= set(first.layers):
        found = extract_layers(video, first, list(names.values()), store, dtype, progress)
        return {layer: found[name].features for layer, name in names.items()}
    return {
        layer: extract(video, encoder.network, store, dtype, progress).features
        for layer, encoder in encoders.items()
    }


def _check_frames(clip: LabelledClip, encoders: Mapping[Layer, LoadedEncoder]) -> None:
    each = max(encoder.network.frames_per_feature for encoder in encoders.values())
    if len(clip.video.times) < each:
        name = next(iter(encoders.values())).name
        raise InputError(
            f"{clip.file.path}: {len(clip.video.times)} frames, but a feature frame of {name} "
            f"stands for {each}; give a longer clip"
        )


def split_of(
    clips: Sequence[SeenClip], layer: Layer, each: int, share: float, by: str = AUTO
) -> Split:
    """Whole clips where there are several, else parts of the one.

    Args:
        clips: of the data set.
        layer: whose feature frames are told apart.
        each: frames that one of them stands for.
        share: that is trained on.
        by: ``clip``; ``time``, which cuts each clip; the name of a fact, whose clips stay together;
            or ``auto``: as the data set says, else by clip.

    Raises:
        InputError: too few clips, no such fact, or a clip that is in two splits.
    """
    frames = [len(clip.labels.times) for clip in clips]
    features = [clip.features[layer].values.shape[1] for clip in clips]
    if len(clips) == 1 or by == TIME:
        return split_times(frames, features, each, share)
    groups = groups_of([clip.file for clip in clips], by)
    roles = roles_by_name([clip.file.split for clip in clips], groups) if by == AUTO else None
    roles = roles or roles_by_group(groups, share)
    paths = [str(clip.file.path) for clip in clips]
    refuse_leaks(paths, [clip.about["sha256"] for clip in clips], roles)
    return split_clips(frames, features, each, roles)


def labelled(
    clips: Sequence[SeenClip],
    layer: Layer,
    frames: Sequence[Tensor],
    each: int,
    folder: Path | None = None,
) -> LabelledFrames:
    """Feature frames with what a readout should say of them.

    Args:
        clips, layer, frames, each: see :func:`pieces`.
        folder: where they lie if they are many; see :func:`vidphys.data.room.room`.
    """
    return joined(pieces(clips, layer, frames, each), sum(map(len, frames)), folder)


def pieces(
    clips: Sequence[SeenClip], layer: Layer, frames: Sequence[Tensor], each: int
) -> Iterator[LabelledFrames]:
    """The same, a few frames at a time.

    Args:
        clips: of the data set.
        layer: of the features.
        frames: numbers of the wanted feature frames of each clip.
        each: frames that a feature frame stands for.
    """
    centres = clips[0].features[layer].cell_centres()
    for clip, wanted in zip(clips, frames, strict=True):
        values = clip.features[layer].values[0]
        targets, weight = frame_targets(clip.labels, len(values), each)
        for some in few(wanted):
            yield LabelledFrames(values[some], centres, targets[some], weight[some])


def few(frames: Tensor) -> Iterator[Tensor]:
    """Numbers of frames, some at a time: the features of all of a long clip would not fit."""
    return iter(frames.split(AT_ONCE) if len(frames) else ())
