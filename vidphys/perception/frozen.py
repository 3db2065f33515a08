"""Rungs over frozen encoders: features once, and a trained readout that says where bodies are.

The readout is trained on true positions, as the supervised CNN is; only the encoder differs, and
it is never trained (inventory E7-E10, Q1). A rung whose weights are not on the machine is skipped.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch
from torch import Tensor

from binders import Tracks
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.store import FeatureRequest, FeatureStore
from readouts.attention import AttentionReadout
from vidphys.clips import Clips
from vidphys.errors import InputError
from vidphys.extraction import FrozenEncoder
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.readout_training import labelled_frames, read_all, train_readout
from vidphys.seeding import derive
from vidphys.train import FitSettings

SHARE = 4  # a frozen rung sees the preset's clips over this: each frame costs tens of milliseconds
HELD_OUT = 8  # one clip in so many decides which weights of the readout are kept
LEARNING_RATE, CLIP = 3e-3, 1.0
STEPS = 4  # of the readout, over the preset's for a perception


@dataclass(frozen=True)
class FrozenPerception:
    """A frozen image encoder and the readout that was trained over it.

    Args:
        encoder: sees each frame alone.
        readout: positions in normalised image units.
        half_extent: world units of one such unit.
        folder: where features are kept; ``None`` keeps none.
    """

    encoder: FrozenEncoder
    readout: AttentionReadout
    half_extent: float
    folder: Path | None

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, and the certainty of the attention."""
        features = encode_clips(self.encoder, clips, self.folder)
        values = features.values.flatten(0, 1)
        positions, confidence = read_all(self.readout, values, features.cell_centres())
        shape = clips.frames.shape[:2]
        world = self.half_extent * positions.unflatten(0, shape)
        return Tracks(world.double(), confidence.unflatten(0, shape).double(), clips.times)


def encode_clips(encoder: FrozenEncoder, clips: Clips, folder: Path | None) -> FeatureMap:
    """Features of every frame, ``(b, t, c, h, w)``, from the folder's store where they lie there.

    Frames are seen one by one, so that all clips are encoded as one long one.
    """
    frames = clips.frames.flatten(0, 1)
    times = clips.interval * torch.arange(len(frames), dtype=torch.float64)
    request = FeatureRequest(
        encoder=encoder.identity,
        source_sha256=hashlib.sha256(frames.numpy().tobytes()).hexdigest(),
        frames=tuple(range(len(frames))),
        times=tuple(times.tolist()),
        frame_size=(frames.shape[-2], frames.shape[-1]),
    )
    if folder is None:
        with TemporaryDirectory() as scratch:
            return _encoded(encoder, request, frames, times, Path(scratch), clips)
    return _encoded(encoder, request, frames, times, folder / "features", clips)


def _encoded(
    encoder: FrozenEncoder,
    request: FeatureRequest,
    frames: Tensor,
    times: Tensor,
    store: Path,
    clips: Clips,
) -> FeatureMap:
    found = FeatureStore(store).get(
        request, "rendered clips", lambda: encoder(frames.unsqueeze(0), times)
    )
    values = found.values[0].unflatten(0, clips.frames.shape[:2])
    return FeatureMap(values, found.stride, clips.times)


def fit_frozen(encoder_name: str, task: FitTask) -> Perception:
    """Encode the training clips, and train the readout on their true positions.

    Raises:
        WeightsMissing: the encoder's weights are not on this machine.
        InputError: too few clips to hold one out.
    """
    encoder = load_encoder(encoder_name, {})
    clips, count = task.clips, len(task.clips)
    held_out = max(1, count // HELD_OUT)
    if count < 2:
        raise InputError(
            f"{encoder_name}: {count} training clips; one is held out, use two or more"
        )
    features = encode_clips(encoder, clips, task.folder)
    half_extent = clips.world.camera.half_extent
    targets = (clips.states.q / half_extent).float()
    sure = torch.ones(targets.shape[:-1])
    train, kept = (
        labelled_frames(
            FeatureMap(features.values[part], features.stride, features.times),
            targets[part],
            sure[part],
        )
        for part in (slice(0, count - held_out), slice(count - held_out, None))
    )
    torch.manual_seed(derive(task.seed, "init", encoder_name))
    readout = AttentionReadout(features.values.shape[2], targets.shape[2])
    steps = STEPS * task.sizes.perception_steps
    settings = FitSettings(steps, task.sizes.perception_batch, LEARNING_RATE, CLIP)
    order = derive(task.seed, "order", encoder_name)
    train_readout(readout, train, kept, settings, order, progress=task.progress)
    return FrozenPerception(encoder, readout.eval(), half_extent, task.folder)


FROZEN_GROUNDINGS = [
    Grounding("hiera", "rgb", "hiera", "none", False, partial(fit_frozen, "hiera"), share=SHARE),
]
