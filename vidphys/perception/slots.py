"""The rung of slot attention: detection and binding learned together, from frames alone.

Slots find the bodies of a frame and are carried to the next. They learn by reconstruction through
the fixed renderer; a learned tracker (B3) then says who is who where bodies that look alike met.
The study's own slot attention fails here (N68).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn
from torch.nn import functional

from binders import Detections
from binders.slots import CHANNELS, Found, SlotAttention
from encoders.cnn import ConvEncoder
from encoders.features import FeatureMap
from vidphys.clips import Clips
from vidphys.perception.anonymous import LearnedBinding, learn_hindsight
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.perception.cnn import train
from vidphys.perception.detections import anonymous_world
from vidphys.perception.dreams import Dream, Dreams, light_spread
from vidphys.perception.reconstruction import Reconstruction, told
from vidphys.perception.windows import Window, WindowBatches
from vidphys.seeding import derive
from vidphys.train import FitSettings

NAME = "anonymous-slots"
AWAKE = 0.25  # steps of the second training over those of the first
TRACKER_CLIPS = 256  # at most, that the tracker learns from
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

    def detect(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """World positions ``(b, t, n, 2)`` and confidence ``(b, t, n)``.

        Slots are started from several rings; in each frame those stand that doubt least.
        """
        tokens = self.tokens(seen)
        rings = 2 * math.pi / max(1, self.bodies) / STARTS * torch.arange(STARTS)
        found = [self.follow(tokens, turn) for turn in rings.tolist()]
        positions = torch.stack([_over_time([f.slots.position for f in one]) for one in found])
        doubt = torch.stack([_over_time([f.doubt for f in one]) for one in found])
        best = doubt.sum(-1).argmin(0)[None, :, :, None]
        doubt = doubt.gather(0, best.expand_as(doubt[:1])).squeeze(0)
        place = best.unsqueeze(-1).expand_as(positions[:1])
        squared = self.fine**2 * doubt.clamp_min(0).expm1()
        return self.half_extent * positions.gather(0, place).squeeze(0), 1 / (1 + squared / SURE**2)


def _over_time(parts: list[Tensor]) -> Tensor:
    return torch.stack(parts, 1)


@dataclass(frozen=True)
class SlotSight:
    """What trained slots find in clips.

    Args:
        detector: trained.
    """

    detector: SlotDetector

    def __call__(self, clips: Clips) -> Detections:
        anonymous_world(clips)
        with torch.no_grad():
            parts = [
                self.detector.detect(clips.images(slice(at, at + CHUNK)))
                for at in range(0, len(clips), CHUNK)
            ]
        positions, confidence = (torch.cat(x) for x in zip(*parts, strict=True))
        return Detections(positions, confidence, clips.times.float())


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
    if AWAKE:
        later = replace(settings, steps=int(AWAKE * settings.steps), learning_rate=1e-3)
        train(task, NAME + "-awake", detector, awake, WindowBatches(task.clips, LENGTH), later)
    sight = SlotSight(detector.eval())
    fewer = replace(task, clips=task.clips.first(TRACKER_CLIPS))
    tracker = learn_hindsight(fewer, NAME + "-tracker", sight(fewer.clips))
    return LearnedBinding(tracker, hypotheses=1, detect=sight)


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
