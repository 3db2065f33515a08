"""Rungs over frozen encoders: features once, and a trained readout that says where bodies are.

The readout is trained on true positions, as the supervised CNN is, or without labels on where a
tracker of colours sees the bodies, as the study's is; only the encoder differs, and it is never
trained. A rung whose weights are not on the machine is skipped.
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
from readouts.base import FrameReadout
from readouts.kinds import MapShape
from readouts.local import RefinedReadout
from readouts.pooled import pooled_twin
from vidphys.data.clips import Clips
from vidphys.data.encounters import encounters
from vidphys.data.extraction import Axes, mirrored
from vidphys.data.labelled import LabelledFrames, joined, labelled_frames
from vidphys.errors import InputError
from vidphys.perception.base import (
    COLOURS,
    LABELS,
    REDRAWS,
    TRACKER,
    FitTask,
    Grounding,
    Perception,
)
from vidphys.perception.palette import PaletteTracking
from vidphys.reading.attention import attention_of
from vidphys.reading.reader import LoadedEncoder, Reader
from vidphys.seeding import derive
from vidphys.training.candidates import Examples
from vidphys.training.early_stopping import StopSettings
from vidphys.training.loop import FitSettings
from vidphys.training.readouts import ReadoutSettings, train_readout
from vidphys.training.refinement import train_refined


@dataclass(frozen=True)
class FrozenSettings:
    """How the frozen rungs are trained.

    Args:
        share: a frozen rung sees the preset's clips over this: each frame costs tens of
            milliseconds.
        held_out: one clip in so many decides which weights of the readout are kept.
        learning_rate: peak.
        clip: largest gradient norm.
        steps: of the readout, over the preset's for a perception.
        looks: at what is held out, in each part of the readout's training.
        at_once: clips that are encoded before their features are put by.
    """

    share: int = 2
    held_out: int = 8
    learning_rate: float = 3e-3
    clip: float = 1.0
    steps: int = 9
    looks: int = 10
    at_once: int = 16


SETTINGS = FrozenSettings()
REACH = 2  # frames to either side that an encoder with frame differencing looks at


@dataclass(frozen=True)
class FrozenPerception:
    """A rung that reads rendered clips.

    Args:
        reader: over the rung's encoder.
        folder: where features are kept; ``None`` keeps none.
    """

    reader: Reader
    folder: Path | None

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame, and how sure the readout is of them."""
        return _precise(self.reader.tracks(self._see(clips, ()), clips.times))

    def closely(self, clips: Clips) -> Tracks:
        """As :meth:`tracks`, averaged over the frames and their mirror images."""
        return _precise(self.reader.closely(partial(self._see, clips), clips.times))

    def attention(self, clips: Clips) -> Tensor | None:
        """What the readout attends to in one clip; ``None`` where it averages over all cells."""
        network = self.reader.encoder.network
        features = encode_clips(network, clips, None)
        return attention_of(self.reader.readout, features, torch.arange(clips.frames.shape[1]))

    def _see(self, clips: Clips, axes: Axes) -> FeatureMap:
        seen = replace(clips, frames=mirrored(clips.frames, axes))
        return encode_clips(self.reader.encoder.network, seen, self.folder)


def _precise(tracks: Tracks) -> Tracks:
    return Tracks(tracks.positions.double(), tracks.confidence.double(), tracks.times)


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
        for frames in clips.frames.split(SETTINGS.at_once):
            found = encoder(frames, clips.times)
            values.append(found.values.flatten(0, 1).to(DTYPES[request.dtype]).cpu())
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
    anchored: bool = False,
    random: bool = False,
    difference: int | None = None,
    how: FrozenSettings = SETTINGS,
) -> Perception:
    """Load an encoder and train a readout over it.

    Args:
        encoder_name: of ``encoders.frozen.catalogue``.
        options: of its settings.
        task, pooled, together, anchored, how: see :func:`fit_readout`.
        random: the same network with weights that were never trained, as a control.
        difference: of an encoder of images: frames to either side over which the change of its
            features is read beside them; not read where not given.

    Raises:
        WeightsMissing: the encoder's weights are not on this machine, and are not random.
        InputError: see :func:`fit_readout`.
    """
    if difference is not None:
        options = options | {"difference": difference}
    seed = {"seed": derive(task.seed, "weights", encoder_name)} if random else {}
    network = load_encoder(encoder_name, options | seed, device=task.device)
    encoder = LoadedEncoder(encoder_name, options, network)
    return fit_readout(encoder, task, pooled, together, anchored, how)


def fit_readout(
    encoder: LoadedEncoder,
    task: FitTask,
    pooled: bool = False,
    together: int | None = None,
    anchored: bool = False,
    how: FrozenSettings = SETTINGS,
) -> Perception:
    """Encode the training clips, and train a readout on positions in them.

    Args:
        encoder: frozen; its name is that of the random streams, too.
        task: see :class:`FitTask`.
        pooled: read the mean over the cells, with as many parameters, in place of attending.
        together: frames that the encoder is to see together, for made encounters: 1 for one that
            sees each by itself; those of whole clips where not given.
        anchored: learn from where a tracker of colours sees the bodies, as the study does, in
            place of true positions; no clip is made then.
        how: see :class:`FrozenSettings`.

    Raises:
        InputError: too few clips to hold one out, or a number of frames that its feature frames
            do not divide.
    """
    clips, count = task.clips, len(task.clips)
    held_out = max(1, count // how.held_out)
    if count < 2:
        raise InputError(
            f"{encoder.name}: {count} training clips; one is held out, use two or more"
        )
    features = encode_clips(encoder.network, clips, task.folder)
    frames, seen = clips.frames.shape[1], features.values.shape[1]
    if frames % seen:
        raise InputError(
            f"{encoder.name}: {frames} frames a clip give {seen} feature frames, which do not "
            "divide them; use another number of frames"
        )
    tracks = PaletteTracking(device=task.device).tracks(clips) if anchored else None
    every, last = labelled(clips, features, tracks), (count - held_out) * seen
    train, kept = every[:last], every[last:]
    few = clips.first(0 if anchored else count - held_out)
    more = meeting(encoder.network, few, together or frames, task)
    parts = [train, *more]
    examples = Examples(joined(parts, sum(map(len, parts))), kept)
    bodies = clips.states.q.shape[2]
    shape = MapShape(features.values.shape[2], features.grid, bodies, frames // seen)
    readout = _train(encoder.name, examples, shape, task, pooled, how).eval()
    return FrozenPerception(
        Reader(encoder, readout, bodies, clips.world.camera.half_extent), task.folder
    )


def labelled(clips: Clips, features: FeatureMap, tracks: Tracks | None = None) -> LabelledFrames:
    """All feature frames of some clips with the positions in the frames they stand for.

    Args:
        clips: whose true positions are taken where there are no tracks.
        features: of them.
        tracks: where bodies were seen; each counts by how sure that is.
    """
    seen = features.values.shape[1]
    q = clips.states.q if tracks is None else tracks.positions
    sure = torch.ones(q.shape[:-1]) if tracks is None else tracks.confidence
    places = (q / clips.world.camera.half_extent).float()
    targets = places.unflatten(1, (seen, -1)).flatten(2, 3)
    return labelled_frames(features, targets, sure.unflatten(1, (seen, -1)).flatten(2, 3))


def meeting(
    encoder: IdentifiedEncoder, clips: Clips, length: int, task: FitTask
) -> list[LabelledFrames]:
    """Frames of encounters beside those of the clips, none where the preset asks for none.

    Args:
        encoder: frozen.
        clips: whose paths they are made of; none make none.
        length: frames of a clip that the encoder needs: the fewer, the more different encounters
            for as many frames.
        task: see :class:`FitTask`.
    """
    count = task.sizes.encounters * clips.frames.shape[1] // length
    if not count or not len(clips):
        return []
    made = encounters(clips, count, length, derive(task.seed, "encounters"))
    return [labelled(made, encode_clips(encoder, made, task.folder))]


def _train(
    encoder_name: str,
    examples: Examples,
    shape: MapShape,
    task: FitTask,
    pooled: bool,
    how: FrozenSettings,
) -> FrameReadout:
    torch.manual_seed(derive(task.seed, "init", encoder_name))
    refined = RefinedReadout(
        shape.channels, shape.positions, shape.grid, shape.frames, task.sizes.readers
    ).to(task.device)
    steps, batch = how.steps * task.sizes.perception_steps, task.sizes.perception_batch
    settings = ReadoutSettings(FitSettings(steps, batch, how.learning_rate, how.clip))
    data = examples.train, examples.held_out
    order = derive(task.seed, "order", encoder_name)
    if pooled:
        control = pooled_twin(refined, shape.channels, shape.positions).to(task.device)
        train_readout(control, *data, settings, order, progress=task.progress)
        return control
    looking = replace(settings, stop=StopSettings(how.looks))
    train_refined(refined, *data, looking, order, progress=task.progress)
    return refined


def rung_over(
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
    seen = name, "rgb", encoder, "none", False
    return Grounding(*seen, fit, LABELS, REDRAWS, share=SETTINGS.share)


def with_variants(rung: Grounding) -> list[Grounding]:
    """A frozen rung; the same without labels, as the study has it; and with random weights."""
    return [
        rung,
        rung.varied("anchored", TRACKER, f"{COLOURS} (its anchor)", anchored=True),
        rung.varied("random", random=True),
    ]


_TRAINED = [
    rung_over("hiera", "hiera", video=False),
    # its first stage, shown each frame twice, looks a frame back and two ahead
    rung_over("i3d", "i3d", video=True, together=4, layer="Conv3d_1a_7x7", resolution=64, shown=2),
    rung_over("dino-tiny", "dino-tiny", video=False, batch=8),
    rung_over("videomae-tiny", "videomae-tiny", video=True, batch=8),
    rung_over("vjepa2-tiny", "vjepa2-tiny", video=True, batch=8),
    rung_over("dinov2", "dinov2-small", video=False),
    rung_over("videomae", "videomae-base", video=True),
    rung_over("videomae-pooled", "videomae-base", video=True, pooled=True),
    *(rung_over(f"vjepa2-{size}", f"vjepa2-{size}", video=True) for size in ("l", "h", "g", "ac")),
]
FROZEN_GROUNDINGS = [
    *(each for rung in _TRAINED for each in with_variants(rung)),
    # encoders of images, with frame differencing
    *(
        rung.varied("diff", together=2 * REACH + 1, difference=REACH)
        for rung in _TRAINED
        if rung.name in ("hiera", "dino-tiny", "dinov2")
    ),
]
