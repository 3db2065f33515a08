"""Rungs over frozen encoders: features once, and a trained readout that says where bodies are.

The readout is trained on true positions, as the supervised CNN is; only the encoder differs, and
it is never trained (inventory E7-E10, Q1). A rung whose weights are not on the machine is skipped.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import torch
from torch import Tensor

from binders import Tracks
from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.identity import IdentifiedEncoder
from encoders.store import DTYPES, FeatureRequest, FeatureStore
from readouts.attention import confidence_at, distance_at
from readouts.local import RefinedReadout
from readouts.pooled import PooledReadout, pooled_twin
from vidphys.data.clips import Clips
from vidphys.data.encounters import encounters
from vidphys.data.labelled import LabelledFrames, joined, labelled_frames
from vidphys.errors import InputError
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.seeding import derive
from vidphys.training.candidates import Examples
from vidphys.training.loop import FitSettings
from vidphys.training.readouts import ReadoutSettings, read_all, train_readout
from vidphys.training.refinement import train_refined

SHARE = 2  # a frozen rung sees the preset's clips over this: each frame costs tens of milliseconds
HELD_OUT = 8  # one clip in so many decides which weights of the readout are kept
LEARNING_RATE, CLIP = 3e-3, 1.0
AT_ONCE = 16  # clips that are encoded before their features are put by
ALONG_X, ALONG_Y = -1, -2  # axes of frames, (..., H, W)
MIRRORS = ((), (ALONG_X,), (ALONG_Y,), (ALONG_X, ALONG_Y))
COARSE, FINE = 1, 8  # steps of the readout's two parts, over the preset's for a perception


@dataclass(frozen=True)
class FrozenPerception:
    """A frozen encoder and the readout that was trained over it.

    Args:
        encoder: of images or of video. A feature frame of a video encoder stands for several
            frames of the clip; the readout has a query for each body in each of them.
        readout: positions in normalised image units.
        half_extent: world units of one such unit.
        folder: where features are kept; ``None`` keeps none.
    """

    encoder: IdentifiedEncoder
    readout: RefinedReadout | PooledReadout
    half_extent: float
    folder: Path | None

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, and how sure the readout is of them."""
        return self._tracks(clips, *self._read(clips, ()))

    def closely(self, clips: Clips) -> Tracks:
        """As :meth:`tracks`, averaged over the frames and their mirror images.

        To the readout these are other pictures, so that much of its error averages out. The
        confidence is that of one of them: the mean deserves somewhat more.
        """
        positions, distance = zip(*(self._read(clips, axes) for axes in MIRRORS), strict=True)
        return self._tracks(clips, torch.stack(positions).mean(0), torch.stack(distance).mean(0))

    def _read(self, clips: Clips, axes: tuple[int, ...]) -> tuple[Tensor, Tensor]:
        """Positions, and the error expected of them, of frames mirrored along some axes."""
        seen = replace(clips, frames=clips.frames.flip(axes))
        features = encode_clips(self.encoder, seen, self.folder)
        values = features.values.flatten(0, 1)
        positions, confidence = read_all(self.readout, values, features.cell_centres())
        sign = torch.tensor([-1.0 if axis in axes else 1.0 for axis in (ALONG_X, ALONG_Y)])
        return sign * positions, distance_at(confidence)

    def _tracks(self, clips: Clips, positions: Tensor, distance: Tensor) -> Tracks:
        shape = clips.states.q.shape
        world = self.half_extent * positions.reshape(shape)
        sure = confidence_at(distance).reshape(shape[:-1])
        return Tracks(world.double(), sure.double(), clips.times)


def encode_clips(encoder: IdentifiedEncoder, clips: Clips, folder: Path | None) -> FeatureMap:
    """Features of every clip, ``(b, t, c, h, w)``, from the folder's store where they lie there."""
    b, t = clips.frames.shape[:2]
    request = FeatureRequest(
        encoder=encoder.identity,
        source_sha256=hashlib.sha256(clips.frames.numpy().tobytes()).hexdigest(),
        frames=tuple(range(b * t)),
        times=tuple(clips.times.repeat(b).tolist()),
        frame_size=(clips.frames.shape[-2], clips.frames.shape[-1]),
    )

    def encode() -> FeatureMap:
        """All clips as one long episode, which is what a store holds; halved as they come."""
        values = []
        for frames in clips.frames.split(AT_ONCE):
            found = encoder(frames, clips.times)
            values.append(found.values.flatten(0, 1).to(DTYPES[request.dtype]))
        return FeatureMap(torch.cat(values)[None], found.stride, found.times.repeat(b))

    with TemporaryDirectory() as scratch:
        store = FeatureStore(Path(scratch) if folder is None else folder / "features")
        found = store.get(request, "rendered clips", encode)
    values = found.values[0].unflatten(0, (b, -1))
    return FeatureMap(values, found.stride, found.times[: values.shape[1]])


def fit_frozen(
    encoder_name: str,
    options: dict[str, Any],
    task: FitTask,
    pooled: bool = False,
    together: int | None = None,
) -> Perception:
    """Load an encoder and train a readout over it; see :func:`fit_readout`.

    Args:
        encoder_name: of ``encoders.frozen.catalogue``.
        options: of its settings.
        task: see :class:`FitTask`.
        pooled: the control in place of spatial attention.
        together: see :func:`fit_readout`.

    Raises:
        WeightsMissing: the encoder's weights are not on this machine.
        InputError: see :func:`fit_readout`.
    """
    encoder = load_encoder(encoder_name, options)
    return fit_readout(encoder, encoder_name, task, pooled, together)


def fit_readout(
    encoder: IdentifiedEncoder,
    encoder_name: str,
    task: FitTask,
    pooled: bool = False,
    together: int | None = None,
) -> Perception:
    """Encode the training clips, and train a readout on their true positions.

    Args:
        encoder: frozen.
        encoder_name: of the random streams and of what is said to the user.
        task: see :class:`FitTask`.
        pooled: read the mean over the cells, with as many parameters, in place of attending.
        together: frames that the encoder is to see together, for made encounters: 1 for one that
            sees each by itself; those of whole clips where not given.

    Raises:
        InputError: too few clips to hold one out, or a number of frames that its feature frames
            do not divide.
    """
    clips, count = task.clips, len(task.clips)
    held_out = max(1, count // HELD_OUT)
    if count < 2:
        raise InputError(
            f"{encoder_name}: {count} training clips; one is held out, use two or more"
        )
    features = encode_clips(encoder, clips, task.folder)
    frames, seen = clips.frames.shape[1], features.values.shape[1]
    if frames % seen:
        raise InputError(
            f"{encoder_name}: {frames} frames a clip give {seen} feature frames, which do not "
            "divide them; use another number of frames"
        )
    every, last = labelled(clips, features), (count - held_out) * seen
    train, kept = every[:last], every[last:]
    more = meeting(encoder, clips.first(count - held_out), together or frames, task)
    train = joined([train, *more])
    readout = _train(encoder_name, Examples(train, kept), frames // seen, task, pooled)
    return FrozenPerception(encoder, readout.eval(), clips.world.camera.half_extent, task.folder)


def labelled(clips: Clips, features: FeatureMap) -> LabelledFrames:
    """All feature frames of some clips with the true positions in the frames they stand for."""
    seen = features.values.shape[1]
    places = (clips.states.q / clips.world.camera.half_extent).float()
    targets = places.unflatten(1, (seen, -1)).flatten(2, 3)
    return labelled_frames(features, targets, torch.ones(targets.shape[:-1]))


def meeting(
    encoder: IdentifiedEncoder, clips: Clips, length: int, task: FitTask
) -> list[LabelledFrames]:
    """Frames of encounters beside those of the clips, none where the preset asks for none.

    Args:
        encoder: frozen.
        clips: whose paths they are made of.
        length: frames of a clip that the encoder needs: the fewer, the more different encounters
            for as many frames.
        task: see :class:`FitTask`.
    """
    count = task.sizes.encounters * clips.frames.shape[1] // length
    if not count:
        return []
    made = encounters(clips, count, length, derive(task.seed, "encounters"))
    return [labelled(made, encode_clips(encoder, made, task.folder))]


def _train(
    encoder_name: str, examples: Examples, frames: int, task: FitTask, pooled: bool
) -> RefinedReadout | PooledReadout:
    """A readout of feature frames that stand for so many ``frames`` of the clip."""
    torch.manual_seed(derive(task.seed, "init", encoder_name))
    train, kept = examples.train, examples.held_out
    channels, bodies = train.values.shape[1], train.targets.shape[1]
    refined = RefinedReadout(channels, bodies, train.grid, frames, task.sizes.readers)
    order = derive(task.seed, "order", encoder_name)
    coarse, fine = (
        FitSettings(
            part * task.sizes.perception_steps, task.sizes.perception_batch, LEARNING_RATE, CLIP
        )
        for part in (COARSE, FINE)
    )
    if pooled:
        control = pooled_twin(refined, channels, bodies)
        whole = replace(fine, steps=coarse.steps + fine.steps)
        train_readout(control, train, kept, ReadoutSettings(whole), order, task.progress)
        return control
    train_refined(refined, train, kept, coarse, fine, order, task.progress)
    return refined


def _rung(
    name: str,
    encoder: str,
    video: bool,
    pooled: bool = False,
    together: int | None = None,
    **options: object,
) -> Grounding:
    """A rung of coloured disks over one frozen encoder, of images or of video."""
    together = together if video else 1
    fit = partial(fit_frozen, encoder, options, pooled=pooled, together=together)
    return Grounding(name, "rgb", encoder, "none", False, fit, share=SHARE, whole_context=video)


FROZEN_GROUNDINGS = [
    _rung("hiera", "hiera", video=False),
    # its first stage, shown each frame twice, looks a frame back and two ahead
    _rung("i3d", "i3d", video=True, together=4, layer="Conv3d_1a_7x7", resolution=64, shown=2),
    _rung("dino-tiny", "dino-tiny", video=False, batch=8),
    _rung("videomae-tiny", "videomae-tiny", video=True, batch=8),
    _rung("vjepa2-tiny", "vjepa2-tiny", video=True, batch=8),
    _rung("dinov2", "dinov2-small", video=False),
    _rung("videomae", "videomae-base", video=True),
    _rung("videomae-pooled", "videomae-base", video=True, pooled=True),
    *(_rung(f"vjepa2-{size}", f"vjepa2-{size}", video=True) for size in ("l", "h", "g", "ac")),
]
