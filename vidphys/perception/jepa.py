"""The JEPA rungs: no frame is ever drawn; the head predicts what an encoder will say.

The latent is a state, z = (q, p): positions from the encoder, momenta from central differences.
The head rolls the online encoder's latent to later frames, and the error is its distance from an
EMA encoder's latent of those frames (inventory E2 to E5). Nothing in that says where a body is:
what does, if anything, is the anchor.
"""

from __future__ import annotations

import math
from typing import cast

import torch
from torch import Tensor, nn

from dynamics import Head, PhaseState
from encoders.jepa import EmaTarget, variance_floor
from readouts.differencing import central_difference
from renderers import centroids
from vidphys.data.clips import Clips
from vidphys.perception.base import FitTask, Perception
from vidphys.perception.cnn import CHUNK, CnnPerception, new_perception, train
from vidphys.perception.discovered import FUTURE, SEEN, joint_settings, new_head
from vidphys.perception.windows import Window, WindowBatches, steps_per_frame
from vidphys.shooting.step import HEAD_DT, roll

ANCHOR_WEIGHT = 100.0


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

    def __init__(self, perception: JepaPerception, head: Head, every: int, steps: int) -> None:
        super().__init__()
        self.perception, self.head, self.every = perception, head, every
        self.target = EmaTarget(perception, steps)

    def loss(self, window: Window) -> Tensor:
        """Latent prediction error, and the anchor's where the window has targets (world units)."""
        self.target.update(self.perception)
        seen = self.perception.locate(window.frames[:, :SEEN])
        interval = self.every * HEAD_DT
        start = central_difference(seen, window.params.mass, interval)[:, 0]
        future = roll(self.head, start, window.params, 1 + FUTURE, HEAD_DT, self.every)[:, 1:]
        total = distance(future, self.future_latents(window), interval)
        if window.targets is not None:
            anchor = (seen - window.targets[:, :SEEN]).square().mean()
            total = total + ANCHOR_WEIGHT * anchor
        return total

    @torch.no_grad()
    def future_latents(self, window: Window) -> PhaseState:
        """What the EMA encoder says of the frames to be predicted, ``(m, FUTURE, n, 2)``."""
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


def fit_jepa(task: FitTask) -> Perception:
    """No anchor: the objective alone (the study's negative result, N64)."""
    return _fit(task, "jepa", None)


def fit_jepa_centroid(task: FitTask) -> Perception:
    """Label-free anchor: the centre of each channel's light (E4, N61)."""
    return _fit(task, "jepa-centroid", light_centres(task.clips))


def fit_jepa_exact(task: FitTask) -> Perception:
    """Control: the true positions as anchor (E5, N62)."""
    return _fit(task, "jepa-exact", task.clips.states.q.float())


def light_centres(clips: Clips) -> Tensor:
    """The centroid of every channel in every frame, world units, ``(b, t, n, 2)``."""
    chunks = torch.arange(len(clips)).split(CHUNK)
    return torch.cat([centroids(clips.images(i), clips.world.camera)[0] for i in chunks])


def _fit(task: FitTask, grounding: str, targets: Tensor | None) -> Perception:
    name = f"{grounding}-{task.head}"
    perception = new_perception(task, name, JepaPerception)
    head = new_head(task, name)
    jepa = Jepa(perception, head, steps_per_frame(task.clips), task.sizes.perception_steps)
    data = WindowBatches(task.clips, SEEN + FUTURE + 1, targets)
    train(task, name, jepa, jepa.loss, data, joint_settings(task.sizes))
    perception.eval()
    perception.variance_floor = variance_floor(perception.tracks(task.clips).positions)
    return perception
