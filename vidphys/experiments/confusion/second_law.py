"""The second law from video: a port that may only take energy, on clips that run both ways.

Three attracting bodies are drawn, read back from the pixels by the renderer grounding, and a
factored head with a friction port is trained on the tracks (or on the true positions, the oracle
control). The port's rate is read from the trained head. Its exact twin has a rate of either sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import torch
from torch import Tensor

from dynamics import Hamiltonian, Parameters, build, terms
from dynamics.friction import Friction
from readouts.differencing import central_difference
from renderers import Camera, ChannelWorld
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.experiments.confusion.scenes import Kind, Law, Setting, record
from vidphys.perception.synthesis import fit_positions
from vidphys.seeding import derive
from vidphys.shooting.aim import surprise
from vidphys.training.loop import FitSettings, fit

INTERVAL, BODIES = 0.08, 3  # seconds between frames
CLIPS, FRAMES = 96, 16
IMAGE, EDGE = 32, 3.7  # pixels on a side; world units, beyond which a clip leaves the picture
EVERY, AHEAD = 2, 4  # model steps a frame; frames that are predicted after the two that aim
BATCH, PEAK_RATE, CLIP_GRADIENT = 128, 5e-2, 1.0
FIRST_RATE = 0.69  # per second: about half way between the two worlds' rates
POSITIVE, FREE = "linear-drag-positive", "linear-drag-free"
PORTS = {POSITIVE: terms.Drag("linear", "positive"), FREE: terms.Drag("linear", "free")}


@dataclass(frozen=True)
class Film:
    """Clips as they were drawn and as they were read back, ``(e, t, n, 2)`` each."""

    truth: Tensor
    seen: Tensor

    def motion(self) -> Motion:
        """The tracks that were read back, for the energy balance."""
        return motion_of(self.seen.numpy(), INTERVAL)


def film(law: Law, seed: int, clips: int = CLIPS) -> Film:
    """Draw clips of a law and fit every frame's positions to its pixels.

    Args:
        law: acceleration, see :mod:`vidphys.experiments.confusion.scenes`.
        seed: of the episodes.
        clips: how many; those that leave the picture are dropped.
    """
    setting = Setting(0.0, INTERVAL, BODIES, seed)
    recorded = record(Kind("video", law, None), setting, clips, FRAMES).positions
    truth = torch.from_numpy(recorded).float()
    truth = truth[truth.abs().amax((1, 2, 3)) < EDGE]
    world = ChannelWorld(Camera(height=IMAGE, width=IMAGE))
    pictures = torch.cat([(world(q) * 255).round() / 255 for q in truth.split(4)])
    return Film(truth, fit_positions(world, pictures)[0])


def windows(tracks: Tensor, length: int) -> Tensor:
    """Every window of neighbouring frames, ``(e, t, n, 2) -> (windows, length, n, 2)``."""
    return tracks.unfold(1, length, 1).movedim(-1, 2).flatten(0, 1)


def unit_law(count: int) -> Parameters:
    """The law of clips of unit coupling and masses."""
    return Parameters(torch.ones(count), torch.ones(count, BODIES))


def train_port(
    tracks: Tensor, port: str, steps: int, seed: int, balance: float = 0.0
) -> Hamiltonian:
    """Train a factored head and its port together, the rate from between the two worlds'.

    Args:
        tracks: ``(e, t, n, 2)``.
        port: ``linear-drag-positive``, or ``linear-drag-free`` for its exact twin.
        steps: of the optimiser.
        seed: of weights and batches.
        balance: weight of the energy balance (the head's own energy its meter) in the loss.
    """
    torch.manual_seed(derive(seed, "second-law", port))
    term = terms.Hamiltonian(potentials=(terms.Radial(),), ports=(PORTS[port],))
    head = build(term, BODIES, INTERVAL / EVERY)
    assert isinstance(head, Hamiltonian)
    with torch.no_grad():
        # softplus of zero is the same rate
        port_of(head).raw.fill_(0.0 if port == POSITIVE else FIRST_RATE)

    def loss(batch: Tensor) -> Tensor:
        params = unit_law(len(batch))
        total = surprise(head, batch, params, INTERVAL / EVERY, EVERY).mean()
        return total + balance * imbalance(head, batch) if balance else total

    settings = FitSettings(steps, BATCH, PEAK_RATE, CLIP_GRADIENT)
    fit(head, loss, windows(tracks, AHEAD + 2), settings, derive(seed, "order"))
    return head


def port_of(head: Hamiltonian) -> Friction:
    """The one port of a head."""
    return cast(Friction, head.ports[0])


def rate_of(head: Hamiltonian) -> float:
    """The port's rate, per second."""
    return float(port_of(head).coefficient(unit_law(1)).detach())


def imbalance(head: Hamiltonian, batch: Tensor) -> Tensor:
    """Mean of log(1 + r^2): energy lost over a window less what the port took, over K.

    Args:
        head: its own energy is the meter.
        batch: positions ``(m, frames, n, 2)``.
    """
    law = unit_law(len(batch))
    states = central_difference(batch, law.mass, INTERVAL)
    inner = states.q.shape[1]
    energy = torch.stack([head.energy(states[:, k], law) for k in range(inner)], 1)
    power = states.p.square().sum((-2, -1))  # v^2 of unit masses
    rate = port_of(head).coefficient(law)
    spent = rate * INTERVAL * 0.5 * (power[:, 1:] + power[:, :-1]).sum(1)
    kinetic = 0.5 * power.mean(1)
    return ((energy[:, 0] - energy[:, -1] - spent) / kinetic).square().log1p().mean()
