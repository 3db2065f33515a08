"""The rung of slot attention: detection and binding learned together, from frames alone.

Slots find the bodies of a frame and are carried to the next. They learn by reconstruction through
the fixed renderer, and are read the same way: slots propose, the frame's reconstruction decides. A
learned tracker (B3) then says who is who where bodies that look alike met. The study's own slot
attention fails here (N68).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from binders import Detections
from binders.slots import CHANNELS, Found, SlotAttention
from encoders.cnn import ConvEncoder
from encoders.features import FeatureMap
from renderers import AnonymousWorld
from vidphys.data.clips import Clips
from vidphys.perception.anonymous import LearnedBinding, learn_hindsight
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.perception.cnn import train
from vidphys.perception.detections import Remembering, anonymous_world
from vidphys.perception.dreams import Dream, Dreams, light_spread
from vidphys.perception.reconstruction import FAINT, Reconstruction, told
from vidphys.perception.windows import Window, WindowBatches
from vidphys.seeding import derive
from vidphys.training.loop import FitSettings

NAME = "anonymous-slots"
AWAKE = 0.25  # steps on the clips themselves over those in dreams
AWAKE_RATE = 1e-3  # learning rate of those
TRACKER_CLIPS = 128  # at most, that the tracker learns from
LENGTH = 3  # frames of a training window
PIXELS = 32  # a side at least that frames are averaged down to: for the same time, more training
LEARNING_RATE = 3e-3
LARGEST_GRADIENT = 1.0
EARLIER = 0.5  # weight of a round against the next
DOUBT = 0.05  # weight of the doubt's error
TURN = math.pi * (3 - math.sqrt(5))  # golden angle, by which each step's ring of slots is turned
STARTS = 4  # rings that slots start from when clips are read
SURE = 0.06  # world units: an expected error of this size halves the confidence
CHUNK = 16  # clips read at once


class FrameTokens(nn.Module):
    """A small CNN over frames, for slots.

    It sees both flanks of an edge on a logarithmic scale: a soft edge is a smooth slope then, from
    which its place can be read to a small fraction of a pixel.
    """

    def __init__(self) -> None:
        super().__init__()
        self.encoder = ConvEncoder(2, CHANNELS)

    def forward(self, frames: Tensor) -> FeatureMap:
        """Features of frames in [0, 1], ``(b, t, 1, H, W)``, averaged down to ``PIXELS`` a side."""
        pool = max(1, min(frames.shape[-2:]) // PIXELS)
        seen = functional.avg_pool2d(frames.flatten(0, 1), pool).unflatten(0, frames.shape[:2])
        found = self.encoder(torch.cat([seen, 1 - seen], 2), torch.zeros(frames.shape[1]))
        stride = (pool * found.stride[0], pool * found.stride[1])
        return FeatureMap(found.values, stride, found.times)


class SlotDetector(nn.Module):
    """Tokens of clips, and slots that look for bodies in them.

    Args:
        tokens: gives a feature map of ``CHANNELS`` channels of what a clip is shown as.
        bodies: number of slots.
        half_extent: world units of a normalised image unit.
        fine: world units of position error that hardly count.
    """

    step: Tensor

    def __init__(self, tokens: nn.Module, bodies: int, half_extent: float, fine: float) -> None:
        super().__init__()
        self.tokens, self.slots = tokens, SlotAttention()
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
        total = frames.new_zeros(())
        for at, one in enumerate(found):
            here = slice(at, at + 1)
            rounds = one.rounds.unsqueeze(2) * self.half_extent
            error, apart = teacher.error(rounds, truth[:, here], frames[:, here])
            weight = EARLIER ** torch.arange(error.shape[1] - 1, -1, -1.0)
            doubt = (one.doubt - apart[:, -1, 0]).square().mean()
            total = total + (weight * error.mean((0, 2, 3))).sum() + DOUBT * doubt
        return total / len(found)

    def detect(self, seen: Tensor, frames: Tensor, world: AnonymousWorld) -> tuple[Tensor, Tensor]:
        """World positions ``(b, t, n, 2)`` and confidence ``(b, t, n)``.

        Slots are started from several rings; in each frame those stand that explain it best.

        Args:
            seen: what the tokens are made of, ``(b, t, ...)``.
            frames: in [0, 1], ``(b, t, 1, H, W)``.
            world: draws positions.
        """
        tokens = self.tokens(seen)
        best = self._answer(tokens, frames, world, 0.0)
        for ring in range(1, STARTS):
            turn = 2 * math.pi / max(1, self.bodies) * ring / STARTS
            best = best.or_else(self._answer(tokens, frames, world, turn))
        squared = self.fine**2 * best.doubt.clamp_min(0).expm1()
        sure = 1 / (1 + squared / SURE**2) / (1 + best.unlike / FAINT).unsqueeze(-1)
        return best.positions, sure

    def _answer(
        self, tokens: FeatureMap, frames: Tensor, world: AnonymousWorld, turn: float
    ) -> Answer:
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
        teacher: takes the places that slots propose to where they explain the frame.
        show: what the detector's tokens are made of, ``(b, t, ...)``; by default the frames.
    """

    detector: SlotDetector
    teacher: Reconstruction
    show: Callable[[Clips], Tensor] | None = None

    def __call__(self, clips: Clips) -> Detections:
        world = anonymous_world(clips)
        shown = None if self.show is None else self.show(clips)
        parts = []
        with torch.no_grad():
            for at in range(0, len(clips), CHUNK):
                few = slice(at, at + CHUNK)
                frames = clips.images(few)
                seen = frames if shown is None else shown[few]
                found = self.detector.detect(seen, frames, world)
                parts.append(decided(self.teacher, frames, *found))
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


def fit_slots(task: FitTask) -> Perception:
    """Train slots on the frames of the clips, then a tracker on what they find.

    Raises:
        InputError: the clips are not of the anonymous world, or too short.
    """
    world, bodies = anonymous_world(task.clips), task.clips.params.mass.shape[-1]
    teacher = Reconstruction.through(world)
    torch.manual_seed(derive(task.seed, "init", NAME))
    detector = SlotDetector(FrameTokens(), bodies, world.camera.half_extent, teacher.fine)

    def asleep(dream: Dream) -> Tensor:
        return detector.loss(dream.frames, dream.frames, teacher, dream.positions)

    def awake(window: Window) -> Tensor:
        frames = mirrored(window.frames, int(detector.step))
        return detector.loss(frames, frames, teacher)

    settings = slot_settings(task)
    dreams = Dreams(world, bodies, light_spread(task.clips), LENGTH, task.seed)
    train(task, NAME + "-asleep", detector, asleep, dreams, settings)
    later = replace(settings, steps=int(AWAKE * settings.steps), learning_rate=AWAKE_RATE)
    train(task, NAME + "-awake", detector, awake, WindowBatches(task.clips, LENGTH), later)
    sight = Remembering(SlotSight(detector.eval(), teacher))
    fewer = replace(task, clips=task.clips.first(TRACKER_CLIPS))
    tracker = learn_hindsight(fewer, NAME + "-tracker", sight(fewer.clips))
    return LearnedBinding(tracker, detect=sight)


def slot_settings(task: FitTask) -> FitSettings:
    """As many windows a step as make the preset's frames."""
    windows = max(1, task.sizes.perception_batch // LENGTH)
    return FitSettings(task.sizes.perception_steps, windows, LEARNING_RATE, LARGEST_GRADIENT)


def mirrored(frames: Tensor, step: int) -> Tensor:
    """Square frames in one of their eight orientations, another one each step."""
    flip = [axis for axis, bit in ((-1, 1), (-2, 2)) if step & bit]
    turned = (
        frames.transpose(-1, -2) if step & 4 and frames.shape[-1] == frames.shape[-2] else frames
    )
    return turned.flip(flip)


SLOT_GROUNDINGS = [Grounding(NAME, "anonymous", "cnn", "slots", False, fit_slots)]
