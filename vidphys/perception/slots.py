"""The rung of slot attention: detection and binding learned together, from frames alone.

Slots find the bodies of a frame and are carried to the next. They learn by reconstruction through
the fixed renderer, and are read the same way: slots propose, the frame's reconstruction decides. A
learned tracker then says who is who where bodies that look alike met. The study's own slot
attention fails here (its Table grounding).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from binders import Detections
from binders.slots import Found, SlotAttention, SlotSettings
from encoders.cnn import ConvEncoder
from encoders.features import FeatureMap
from vidphys.data.clips import Clips
from vidphys.perception.anonymous import LearnedBinding, TrackingSettings, learn_hindsight
from vidphys.perception.base import BLOBS, DISK, UNTOLD, FitTask, Grounding, Perception
from vidphys.perception.blobs import DrawnWorld
from vidphys.perception.cnn import train
from vidphys.perception.detections import Remembering, anonymous_world, known_world
from vidphys.perception.dreams import Dream, Dreams, light_spread
from vidphys.perception.reconstruction import Reconstruction, TeacherSettings, told
from vidphys.perception.windows import Window, WindowBatches
from vidphys.placement import CPU, device_of, moved
from vidphys.presets import PixelSizes
from vidphys.seeding import derive
from vidphys.training.loop import FitSettings

NAME = "anonymous-slots"
TURN = math.pi * (3 - math.sqrt(5))  # golden angle, by which each step's ring of slots is turned
CHUNK = 16  # clips read at once


@dataclass(frozen=True)
class DetectionSettings:
    """Of slots that learn to detect, and are read.

    Args:
        length: frames of a training window.
        learning_rate: peak.
        clip: largest gradient norm.
        earlier: weight of a round against the next.
        doubt: weight of the doubt's error.
        starts: rings that slots start from when clips are read.
        decided: whether the frame's reconstruction decides where slots propose places; else one
            ring's proposals stand as they are, and their own doubt is all that speaks of trust.
        sure: world units; an expected error of this size halves the confidence.
    """

    attention: SlotSettings = SlotSettings()
    teacher: TeacherSettings = TeacherSettings()
    length: int = 3
    learning_rate: float = 3e-3
    clip: float = 1.0
    earlier: float = 0.5
    doubt: float = 0.05
    starts: int = 4
    decided: bool = True
    sure: float = 0.06

    def fit(self, sizes: PixelSizes) -> FitSettings:
        """As many windows a step as make the preset's frames."""
        windows = max(1, sizes.perception_batch // self.length)
        return FitSettings(sizes.perception_steps, windows, self.learning_rate, self.clip)


@dataclass(frozen=True)
class SlotRungSettings:
    """Of the rung of slot attention.

    Args:
        pixels: a side at least that frames are averaged down to: for the same time, more training.
        strides: of dreamt bodies, world units a frame along each axis, standard deviation.
        awake: steps on the clips themselves over those in dreams.
        awake_rate: learning rate of those.
        tracker_clips: at most, that the tracker learns from.
    """

    detection: DetectionSettings = DetectionSettings()
    tracking: TrackingSettings = TrackingSettings()
    pixels: int = 32
    strides: float = 0.1
    awake: float = 0.25
    awake_rate: float = 1e-3
    tracker_clips: int = 128


class FrameTokens(nn.Module):
    """A small CNN over frames, for slots.

    It sees both flanks of an edge on a logarithmic scale: a soft edge is a smooth slope then, from
    which its place can be read to a small fraction of a pixel.

    Args:
        channels: of the features.
        pixels: a side at least that frames are averaged down to.
    """

    def __init__(
        self, channels: int = SlotSettings.channels, pixels: int = SlotRungSettings.pixels
    ) -> None:
        super().__init__()
        self.encoder, self.pixels = ConvEncoder(2, channels), pixels

    def forward(self, frames: Tensor) -> FeatureMap:
        """Features of frames in [0, 1], ``(b, t, 1, H, W)``."""
        pool = max(1, min(frames.shape[-2:]) // self.pixels)
        seen = functional.avg_pool2d(frames.flatten(0, 1), pool).unflatten(0, frames.shape[:2])
        found = self.encoder(torch.cat([seen, 1 - seen], 2), torch.zeros(frames.shape[1]))
        stride = tuple(pool * pixels for pixels in found.stride)
        return FeatureMap(found.values, stride, found.times)


class SlotDetector(nn.Module):
    """Tokens of clips, and slots that look for bodies in them.

    Args:
        tokens: gives a feature map of what a clip is shown as.
        bodies: number of slots.
        half_extent: world units of a normalised image unit.
        fine: world units of position error that hardly count.
    """

    step: Tensor

    def __init__(
        self,
        tokens: nn.Module,
        bodies: int,
        half_extent: float,
        fine: float,
        settings: DetectionSettings = DetectionSettings(),
    ) -> None:
        super().__init__()
        self.tokens, self.slots, self.settings = tokens, SlotAttention(settings.attention), settings
        self.bodies, self.half_extent, self.fine = bodies, half_extent, fine
        self.register_buffer("step", torch.zeros((), dtype=torch.long))

    def follow(self, tokens: FeatureMap, turn: float) -> list[Found]:
        """Slots through all frames, from a ring that is turned by some radians."""
        return self.slots(tokens, self.slots.start(len(tokens.values), self.bodies, turn))

    def loss(
        self,
        seen: Tensor,
        frames: Tensor,
        teacher: Reconstruction,
        known: Tensor | None = None,
    ) -> Tensor:
        """Error of every round's positions, and of the doubt in them.

        Args:
            seen: what the tokens are made of, ``(m, t, ...)``.
            frames: in [0, 1], ``(m, t, 1, H, W)``.
            teacher: says what is wrong.
            known: positions that the frames were drawn from, world units, ``(m, t, n, 2)``, in any
                order of the bodies; ``None`` where the frames have to be explained.
        """
        found = self.follow(self.tokens(seen), TURN * int(self.step))
        self.step += 1
        last = torch.stack([f.slots.position for f in found], 1).detach() * self.half_extent
        truth = teacher.explain(frames, last) if known is None else told(known, last)
        total, how = frames.new_zeros(()), self.settings
        for at, one in enumerate(found):
            here = slice(at, at + 1)
            rounds = one.rounds.unsqueeze(2) * self.half_extent
            error, apart = teacher.error(rounds, truth[:, here], frames[:, here])
            back = torch.arange(error.shape[1] - 1, -1, -1.0, device=error.device)
            weight = how.earlier**back
            doubt = (one.doubt - apart[:, -1, 0]).square().mean()
            total = total + (weight * error.mean((0, 2, 3))).sum() + how.doubt * doubt
        return total / len(found)

    def detect(self, seen: Tensor, frames: Tensor, world: DrawnWorld) -> tuple[Tensor, Tensor]:
        """World positions ``(b, t, n, 2)`` and confidence ``(b, t, n)``.

        Slots are started from several rings; in each frame those stand that explain it best.
        Where nothing but slots decides, there is one ring.

        Args:
            seen: what the tokens are made of, ``(b, t, ...)``.
            frames: in [0, 1], ``(b, t, 1, H, W)``.
            world: draws positions.
        """
        tokens = self.tokens(seen)
        best = self._answer(tokens, frames, world, 0.0)
        decided, half = self.settings.decided, self.settings.sure
        starts = self.settings.starts if decided else 1
        for ring in range(1, starts):
            turn = 2 * math.pi / max(1, self.bodies) * ring / starts
            best = best.or_else(self._answer(tokens, frames, world, turn))
        squared = self.fine**2 * best.doubt.clamp_min(0).expm1()
        sure = 1 / (1 + squared / half**2)
        if decided:
            sure = sure / (1 + best.unlike / self.settings.teacher.faint).unsqueeze(-1)
        return best.positions, sure

    def _answer(self, tokens: FeatureMap, frames: Tensor, world: DrawnWorld, turn: float) -> Answer:
        found = self.follow(tokens, turn)
        positions = self.half_extent * torch.stack([f.slots.position for f in found], 1)
        unlike = (world(positions) - frames).square().mean((-3, -2, -1))
        return Answer(positions, torch.stack([f.doubt for f in found], 1), unlike)


@dataclass(frozen=True)
class Answer:
    """What slots say of clips.

    Args:
        positions: world units, ``(b, t, n, 2)``.
        doubt: in each, ``(b, t, n)``.
        unlike: mean squared pixel error of the frames that they would make, ``(b, t)``.
    """

    positions: Tensor
    doubt: Tensor
    unlike: Tensor

    def or_else(self, other: Answer) -> Answer:
        """In each frame the answer that explains it better."""
        mine = self.unlike <= other.unlike
        return Answer(
            torch.where(mine[..., None, None], self.positions, other.positions),
            torch.where(mine[..., None], self.doubt, other.doubt),
            torch.where(mine, self.unlike, other.unlike),
        )


@dataclass(frozen=True)
class SlotSight:
    """What trained slots find in clips.

    Args:
        detector: trained.
        teacher: takes the places that slots propose to where they explain the frame, if it is
            the frame that decides.
        show: what the detector's tokens are made of, ``(b, t, ...)``; by default the frames.
    """

    detector: SlotDetector
    teacher: Reconstruction
    show: Callable[[Clips], Tensor] | None = None

    def __call__(self, clips: Clips) -> Detections:
        anonymous_world(clips)
        world, decides = self.teacher.world, self.detector.settings.decided
        shown = None if self.show is None else self.show(clips)
        parts, device = [], device_of(self.detector)
        with torch.no_grad():
            for at in range(0, len(clips), CHUNK):
                few = slice(at, at + CHUNK)
                frames = clips.images(few, device)
                seen = frames if shown is None else shown[few].to(device)
                found = self.detector.detect(seen, frames, world)
                if decides:
                    found = decided(self.teacher, frames, *found)
                parts.append(moved(found, CPU))
        positions, confidence = (torch.cat(x) for x in zip(*parts, strict=True))
        return Detections(positions, confidence, clips.times.float())


def decided(
    teacher: Reconstruction, frames: Tensor, positions: Tensor, confidence: Tensor
) -> tuple[Tensor, Tensor]:
    """Positions that explain their frame, and trust in them; elsewhere what was proposed."""
    explained = teacher.regrouped(frames, teacher.explain(frames, positions))
    believed = explained.believed[..., None]
    moved = torch.where(believed[..., None], explained.positions, positions)
    return moved, torch.where(believed, torch.ones_like(confidence), confidence)


def fit_slots(
    task: FitTask, settings: SlotRungSettings = SlotRungSettings(), blobs: bool = False
) -> Perception:
    """Train slots on the frames of the clips, then a tracker on what they find.

    Raises:
        InputError: the clips are not of the anonymous world, or too short.
    """
    world, bodies = known_world(task.clips, blobs), task.clips.params.mass.shape[-1]
    detection, length = settings.detection, settings.detection.length
    teacher = Reconstruction.through(world, detection.teacher, task.device)
    torch.manual_seed(derive(task.seed, "init", NAME))
    tokens = FrameTokens(detection.attention.channels, settings.pixels)
    size = world.camera.half_extent, teacher.fine
    detector = SlotDetector(tokens, bodies, *size, detection).to(task.device)

    def asleep(dream: Dream) -> Tensor:
        return detector.loss(dream.frames, dream.frames, teacher, dream.positions)

    def awake(window: Window) -> Tensor:
        frames = mirrored(window.frames, int(detector.step))
        return detector.loss(frames, frames, teacher)

    how, light = detection.fit(task.sizes), light_spread(task.clips)
    dreams = Dreams(world, bodies, light, length, task.seed, settings.strides)
    train(task, NAME + "-asleep", detector, asleep, dreams, how)
    steps = int(settings.awake * how.steps)
    later = replace(how, steps=steps, learning_rate=settings.awake_rate)
    train(task, NAME + "-awake", detector, awake, WindowBatches(task.clips, length), later)
    sight = Remembering(SlotSight(detector.eval(), teacher))
    fewer = replace(task, clips=task.clips.first(settings.tracker_clips))
    tracker = learn_hindsight(fewer, NAME + "-tracker", sight(fewer.clips), settings.tracking)
    return LearnedBinding(tracker, None, settings.tracking.hypotheses, sight)


def mirrored(frames: Tensor, step: int) -> Tensor:
    """Square frames in one of their eight orientations, another one each step."""
    flip = [axis for axis, bit in ((-1, 1), (-2, 2)) if step & bit]
    turned = (
        frames.transpose(-1, -2) if step & 4 and frames.shape[-1] == frames.shape[-2] else frames
    )
    return turned.flip(flip)


ALONE = DetectionSettings(decided=False)  # what slots propose, and nothing decides
_OWN = Grounding(NAME, "anonymous", "cnn", "slots", False, fit_slots, UNTOLD, DISK)
SLOT_GROUNDINGS = [
    _OWN,
    _OWN.varied("proposals", settings=SlotRungSettings(ALONE)),
    _OWN.varied("blobs", knows=BLOBS, blobs=True),
]
