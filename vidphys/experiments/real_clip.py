"""A clip nobody rendered, seen by an encoder nobody here trained, up to the perceived track.

clip -> features (cached) -> readout, taught by the hand binder on the first part of the clip and
scored on the rest -> track over the whole clip. What moves by which law is fitted after this.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from binders.motion import MotionSettings, MotionTracks, bind_motion
from binders.tracks import Tracks
from encoders.features import FeatureMap
from encoders.store import FeatureStore
from readouts.attention import AttentionReadout
from readouts.pooled import pooled_twin
from vidphys.errors import InputError
from vidphys.extraction import Extraction, FrozenEncoder, extract
from vidphys.readout_training import (
    ReadoutFit,
    ReadoutSettings,
    labelled_frames,
    position_rmse,
    read_all,
    train_readout,
)
from vidphys.train import FitSettings, Progress
from vidphys.video import Video, require_frames

HELD_OUT_BLOCK = 8
HELD_OUT_EVERY = 5
LEAST_FRAMES = 2 * HELD_OUT_BLOCK * HELD_OUT_EVERY


@dataclass(frozen=True)
class RealClipSettings:
    """How a real clip is taught and scored.

    Args:
        motion: of the hand binder that labels the frames.
        train_share: part of the clip, from its start, whose labels the readout sees.
        fit: of the readouts' optimiser.
        cells: training maps are moved at random by up to so many cells (few labels, few places).
        seed: of initial weights and batch order.
    """

    motion: MotionSettings = field(default_factory=MotionSettings)
    train_share: float = 0.6
    fit: FitSettings = field(
        default_factory=lambda: FitSettings(steps=1200, batch=16, learning_rate=3e-3)
    )
    cells: int = 4
    seed: int = 0


@dataclass(frozen=True)
class Split:
    """Frame numbers: to train on, to stop by (blocks among the former), and to score."""

    train: Tensor
    held_out: Tensor
    scored: Tensor

    @property
    def end(self) -> int:
        """The first frame whose label no readout has seen."""
        return int(self.scored[0])


@dataclass(frozen=True)
class TrainedReadout:
    """A readout and how its training went."""

    module: nn.Module
    fit: ReadoutFit


@dataclass(frozen=True)
class ReadoutScore:
    """Root mean squared distance from the hand binder's track on the scored frames."""

    name: str
    normalised: float
    pixels: float


@dataclass(frozen=True)
class PerceivedClip:
    """Everything that the dynamics fit and the recording start from.

    Args:
        video: the clip.
        hand: the hand binder's track over the whole clip, and the camera's drift.
        extraction: the features and whether they were cached.
        split: which frames were used for what.
        readouts: ``attention`` and ``pooled``.
        track: the attention readout's positions over the whole clip, normalised image units.
        scores: one each for ``attention``, ``pooled`` and ``constant``.
    """

    video: Video
    hand: MotionTracks
    extraction: Extraction
    split: Split
    readouts: dict[str, TrainedReadout]
    track: Tracks
    scores: tuple[ReadoutScore, ...]

    @property
    def steady_track(self) -> Tracks:
        """:attr:`track` as a camera without drift would have seen it."""
        moved = self.track.positions - self.hand.camera[None, :, None]
        return Tracks(moved, self.track.confidence, self.track.times)


def perceive_clip(
    video: Video,
    encoder: FrozenEncoder,
    store: FeatureStore,
    settings: RealClipSettings,
    progress: Progress | None = None,
) -> PerceivedClip:
    """Run all stages; see the module.

    Raises:
        InputError: a clip too short to train and score on, or in which nothing moves.
    """
    require_frames(video, LEAST_FRAMES)
    hand = label_clip(video, settings.motion)
    extraction = extract(video, encoder, store, progress=progress)
    split = split_frames(len(video.frames), settings.train_share)
    readouts = train_readouts(extraction.features, hand.tracks, split, settings, progress)
    track = read_track(readouts["attention"].module, extraction.features)
    scores = score_readouts(readouts, extraction.features, hand.tracks, split, video.size)
    return PerceivedClip(video, hand, extraction, split, readouts, track, scores)


def label_clip(video: Video, motion: MotionSettings) -> MotionTracks:
    """The hand binder's track.

    Raises:
        InputError: nothing that moves was found.
    """
    try:
        return bind_motion(video.frames, video.times, motion)
    except ValueError as error:
        raise InputError(f"{video.path}: {error}") from error


def split_frames(frames: int, train_share: float) -> Split:
    """First part to train on, every fifth block of eight frames of it held out; the rest scored.

    Raises:
        InputError: the share leaves nothing to train on or to score.
    """
    end = round(frames * train_share)
    if not HELD_OUT_BLOCK * HELD_OUT_EVERY <= end < frames:
        raise InputError(
            f"train share {train_share}: leaves {end} of {frames} frames to train on and "
            f"{frames - end} to score; needs at least {HELD_OUT_BLOCK * HELD_OUT_EVERY} and 1"
        )
    frame = torch.arange(end)
    held = (frame // HELD_OUT_BLOCK) % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
    return Split(frame[~held], frame[held], torch.arange(end, frames))


def train_readouts(
    features: FeatureMap,
    tracks: Tracks,
    split: Split,
    settings: RealClipSettings,
    progress: Progress | None = None,
) -> dict[str, TrainedReadout]:
    """The spatial readout and its pooled control, on the same frames and budget."""
    frames = labelled_frames(features, tracks.positions, tracks.confidence)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        attention = AttentionReadout(features.values.shape[2], settings.motion.bodies)
        modules: dict[str, nn.Module] = {"attention": attention, "pooled": pooled_twin(attention)}
    # pooling is blind to a move: moved maps would only teach the control that position is noise
    cells = {"attention": settings.cells, "pooled": 0}
    train, held_out = frames[split.train], frames[split.held_out]
    trained = {}
    for name, module in modules.items():
        how = ReadoutSettings(settings.fit, cells[name])
        fit = train_readout(module, train, held_out, how, settings.seed, progress)
        trained[name] = TrainedReadout(module, fit)
    return trained


def read_track(readout: nn.Module, features: FeatureMap) -> Tracks:
    """Positions over the whole clip, normalised image units."""
    positions, confidence = read_all(readout, features.values[0], features.cell_centres())
    return Tracks(positions[None], confidence[None], features.times)


def score_readouts(
    readouts: dict[str, TrainedReadout],
    features: FeatureMap,
    tracks: Tracks,
    split: Split,
    size: tuple[int, int],
) -> tuple[ReadoutScore, ...]:
    """Distance from the hand binder's track on the scored frames, per readout and for the mean.

    Args:
        readouts: trained ones by name.
        features: of the whole clip.
        tracks: the hand binder's, of the whole clip.
        split: which frames are scored; ``constant`` is the mean position of the training frames.
        size: (height, width) of the frames, for the unit of pixels.
    """
    scored = labelled_frames(features, tracks.positions, tracks.confidence)[split.scored]
    predictions = {
        name: read_all(trained.module, scored.values, scored.centres)[0]
        for name, trained in readouts.items()
    }
    mean = tracks.positions[0, split.train].mean(0)
    predictions["constant"] = mean.expand_as(scored.targets)
    scores = []
    for name, positions in predictions.items():
        rmse = position_rmse(positions, scored.targets, scored.weight)
        scores.append(ReadoutScore(name, rmse, rmse * max(size) / 2))
    return tuple(scores)
