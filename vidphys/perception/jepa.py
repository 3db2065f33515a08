"""The JEPA rungs: no frame is ever drawn; the head predicts what an encoder will say.

The latent is a state, z = (q, p): positions from the encoder, momenta from central differences.
The head rolls the online encoder's latent to later frames, and the error is its distance from an
EMA encoder's latent of those frames. Nothing in that says where a body is: what does, if anything,
is the anchor (the study's Table grounding).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor, nn

from dynamics import Head, PhaseState
from encoders.jepa import MOMENTUM, EmaTarget, variance_floor
from readouts.differencing import central_difference
from renderers import centroids
from vidphys.data.clips import Clips
from vidphys.perception.base import FitTask, Perception
from vidphys.perception.cnn import CHUNK, CnnPerception, new_perception, train
from vidphys.perception.discovered import SEEN, JointSettings, new_head
from vidphys.perception.windows import Window, WindowBatches, steps_per_frame
from vidphys.shooting.step import HEAD_DT, roll


@dataclass(frozen=True)
class JepaSettings:
    """Of the JEPA rungs.

    Args:
        anchor_weight: of the anchor's error, world units squared, against the prediction's.
        first_momentum: of the EMA encoder, a step, at the start of the training.
    """

    joint: JointSettings = JointSettings()
    anchor_weight: float = 100.0
    first_momentum: float = MOMENTUM


class JepaPerception(CnnPerception):
    """The online encoder of a JEPA, and its collapse monitor.

    ``variance_floor`` (world units squared) is the smallest variance that any coordinate of any
    body's position has over the training clips; near zero the latent has collapsed.
    """

    variance_floor: float = math.nan


class Jepa(nn.Module):
    """Online encoder, EMA encoder and head, trained by one loss.

    Args:
        perception: the online encoder.
        head: predicts latents.
        every: model steps between frames.
        steps: of the training, for the EMA's schedule.
    """

    def __init__(
        self,
        perception: JepaPerception,
        head: Head,
        every: int,
        steps: int,
        settings: JepaSettings = JepaSettings(),
    ) -> None:
        super().__init__()
        self.perception, self.head, self.every = perception, head, every
        self.target = EmaTarget(perception, steps, settings.first_momentum)
        self.settings = settings

    def loss(self, window: Window) -> Tensor:
        """Latent prediction error, and the anchor's where the window has targets (world units)."""
        self.target.update(self.perception)
        seen = self.perception.locate(window.frames[:, :SEEN])
        interval = self.every * HEAD_DT
        start = central_difference(seen, window.params.mass, interval)[:, 0]
        frames = 1 + self.settings.joint.future
        future = roll(self.head, start, window.params, frames, HEAD_DT, self.every)[:, 1:]
        total = distance(future, self.future_latents(window), interval)
        if window.targets is not None:
            anchor = (seen - window.targets[:, :SEEN]).square().mean()
            total = total + self.settings.anchor_weight * anchor
        return total

    @torch.no_grad()
    def future_latents(self, window: Window) -> PhaseState:
        """What the EMA encoder says of the frames to be predicted, ``(m, future, n, 2)``."""
        # One frame on either side, for the momentum of the first and the last.
        target = cast(JepaPerception, self.target.module)
        positions = target.locate(window.frames[:, SEEN - 1 :])
        return central_difference(positions, window.params.mass, self.every * HEAD_DT)


def distance(predicted: PhaseState, target: PhaseState, interval: float) -> Tensor:
    """Mean squared distance of latents, world units squared; momenta count by ``interval``.

    A momentum times the frame interval is a length (for unit mass), comparable to a position.
    """
    q = (predicted.q - target.q).square().mean()
    return q + interval**2 * (predicted.p - target.p).square().mean()


def fit_jepa(task: FitTask, settings: JepaSettings = JepaSettings()) -> Perception:
    """No anchor: the objective alone (the study's negative result)."""
    return _fit(task, "jepa", None, settings)


def fit_jepa_centroid(task: FitTask, settings: JepaSettings = JepaSettings()) -> Perception:
    """Label-free anchor: the centre of each channel's light."""
    return _fit(task, "jepa-centroid", light_centres(task.clips), settings)


def fit_jepa_exact(task: FitTask, settings: JepaSettings = JepaSettings()) -> Perception:
    """Control: the true positions as anchor."""
    return _fit(task, "jepa-exact", task.clips.states.q.float(), settings)


def light_centres(clips: Clips) -> Tensor:
    """The centroid of every channel in every frame, world units, ``(b, t, n, 2)``."""
    chunks = torch.arange(len(clips)).split(CHUNK)
    return torch.cat([centroids(clips.images(i), clips.world.camera)[0] for i in chunks])


def _fit(
    task: FitTask, grounding: str, targets: Tensor | None, settings: JepaSettings
) -> Perception:
    name, joint = f"{grounding}-{task.head}", settings.joint
    perception = new_perception(task, name, JepaPerception, joint.features)
    head = new_head(task, name)
    every, steps = steps_per_frame(task.clips), task.sizes.perception_steps
    jepa = Jepa(perception, head, every, steps, settings).to(task.device)
    data = WindowBatches(task.clips, SEEN + joint.future + 1, targets)
    train(task, name, jepa, jepa.loss, data, joint.fit(task.sizes))
    perception.head = head
    perception.eval()
    perception.variance_floor = variance_floor(perception.tracks(task.clips).positions)
    return perception
