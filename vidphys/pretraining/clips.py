"""Clips without labels: bodies that move as in the scenes, drawn with a random look.

Every example is a function of its number alone (look, window, visible tokens), so that a run that
was interrupted goes on with exactly the examples it would have had.
"""

from __future__ import annotations

import colorsys
import math
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Generator, Tensor

from renderers import AnonymousWorld, Camera, RgbWorld
from vidphys.scenes import gravity
from vidphys.seeding import derive

BODIES = (2, 3, 4, 6)
Signs = Literal["both", "attraction"]
# of G; strengths are spread alike in both
COUPLINGS: dict[Signs, tuple[float, float]] = {"both": (-1.5, 1.5), "attraction": (0.0, 1.5)}
STEPS_PER_FRAME = 40  # of the scenes, 0.002 s each: frames 0.08 s apart, as in the ladder
LENGTH = 16  # frames of a simulated trajectory
LOOKS = 4096  # examples drawn from one trajectory
RADII = (0.25, 0.7)  # world units
ZOOM = (0.8, 1.6)  # of positions
SHIFT = 2.0  # world units, largest, of all bodies of a clip
PLAIN = 0.5  # share of clips with the worlds' own colours over black, as the ladder draws them
BACKGROUND = 0.4  # brightest
# how the colours of a picture are changed, for who learns that they do not matter
SATURATION, CONTRAST, BRIGHTNESS = (0.3, 1.2), (0.6, 1.4), (-0.1, 0.2)
NEGATIVE = 0.2  # share of the pictures


@dataclass(frozen=True)
class Layout:
    """What an example looks like to a transformer.

    Args:
        frames: of a clip.
        side: pixels of its square frames.
        patch: pixels of a token's side.
        tubelet: frames of a token.
        visible: share of the tokens that the student sees.
        asked: share of the tokens that it is asked about, of those that it does not see.
    """

    frames: int
    side: int
    patch: int
    tubelet: int
    visible: float
    asked: float

    @property
    def tokens(self) -> int:
        return self.frames // self.tubelet * (self.side // self.patch) ** 2


@dataclass(frozen=True)
class Examples:
    """A batch of clips and what is shown and asked of each.

    Args:
        frames: values in [0, 1], ``(b, t, 3, H, W)``.
        visible, asked: token numbers in rising order, ``(b, v)`` and ``(b, m)``, none in both.
        colours: an affine change of colours for each clip, ``(b, 3, 4)``.
    """

    frames: Tensor
    visible: Tensor
    asked: Tensor
    colours: Tensor

    def to(self, device: str) -> Examples:
        """The same on another device."""
        parts = (self.frames, self.visible, self.asked, self.colours)
        return Examples(*(part.to(device) for part in parts))

    def recoloured(self) -> Examples:
        """The same clips in the changed colours, values in [0, 1]."""
        mixed = torch.einsum("bij,btjhw->btihw", self.colours[..., :3], self.frames)
        offset = self.colours[:, None, :, 3, None, None]
        return replace(self, frames=(mixed + offset).clamp(0, 1))


class RandomClips:
    """Examples by number; see the module.

    Args:
        trajectories: simulated for each number of bodies.
        layout: of an example.
        seed: of trajectories and looks.
        device: where batches are put.
        signs: of the couplings; see ``COUPLINGS``.
    """

    def __init__(
        self,
        trajectories: int,
        layout: Layout,
        seed: int,
        device: str = "cpu",
        signs: Signs = "both",
    ) -> None:
        self.layout, self.seed, self.device = layout, seed, device
        self.camera = Camera(height=layout.side, width=layout.side)
        self.paths = [_paths(bodies, trajectories, seed, COUPLINGS[signs]) for bodies in BODIES]
        self.trajectories = trajectories

    def __len__(self) -> int:
        return len(BODIES) * self.trajectories * LOOKS

    def __getitem__(self, index: Tensor) -> Examples:
        drawn = [self._example(int(i)) for i in index]
        frames, order, colours = (torch.stack(part) for part in zip(*drawn, strict=True))
        visible, asked = (
            round(share * self.layout.tokens) for share in (self.layout.visible, self.layout.asked)
        )
        seen, unseen = order[:, :visible], order[:, visible : visible + asked]
        visible_at, asked_at = seen.sort(1).values, unseen.sort(1).values
        return Examples(frames, visible_at, asked_at, colours).to(self.device)

    def _example(self, number: int) -> tuple[Tensor, Tensor, Tensor]:
        """Frames ``(t, 3, H, W)``, a random order of the tokens, and a change of colours."""
        rng = Generator().manual_seed(derive(self.seed, "look", str(number)))
        paths = self.paths[number % len(BODIES)]
        path = paths[number // len(BODIES) % self.trajectories]
        first = int(torch.randint(LENGTH - self.layout.frames + 1, (1,), generator=rng))
        q = _moved(path[first : first + self.layout.frames], rng)
        frames = _drawn(q, self.camera, rng)
        return frames, torch.randperm(self.layout.tokens, generator=rng), _colours(rng)


def _paths(bodies: int, count: int, seed: int, coupling: tuple[float, float]) -> Tensor:
    """Positions of simulated bodies, world units, ``(count, t, n, 2)``; wild episodes dropped."""
    scene = gravity(bodies=bodies, mass=(1.0, 1.0), coupling=coupling)
    rng = Generator().manual_seed(derive(seed, "paths", str(bodies)))
    steps = (LENGTH - 1) * STEPS_PER_FRAME
    rolled = scene.simulate(*scene.sample(2 * count, rng), steps, STEPS_PER_FRAME)
    return rolled.states.q[rolled.finite][:count].float()


def _moved(q: Tensor, rng: Generator) -> Tensor:
    """Turned, mirrored, zoomed and shifted at random."""
    angle, mirror, zoom, *_ = torch.rand(3, generator=rng).tolist()
    cos, sin = math.cos(2 * math.pi * angle), math.sin(2 * math.pi * angle)
    turn = q.new_tensor([[cos, -sin], [sin, cos]])
    if mirror < 0.5:
        turn = turn.flip(0)
    shift = SHIFT * (2 * torch.rand(2, generator=rng) - 1)
    return _between(ZOOM, zoom) * q @ turn + shift


def _drawn(q: Tensor, camera: Camera, rng: Generator) -> Tensor:
    """Disks of a random radius, in random colours over a random background."""
    plain, size = torch.rand(2, generator=rng).tolist()
    hues = torch.rand(max(BODIES), 3, generator=rng).tolist()
    background = BACKGROUND * torch.rand(3, 1, 1, generator=rng)
    radius = _between(RADII, size)
    if plain < PLAIN:
        return RgbWorld(camera, radius)(q)
    palette = tuple(colorsys.hsv_to_rgb(h, 0.4 + 0.6 * s, 0.6 + 0.4 * v) for h, s, v in hues)
    empty = 1 - AnonymousWorld(camera, radius)(q)
    return (RgbWorld(camera, radius, palette=palette)(q) + empty * background).clamp(0, 1)


def _colours(rng: Generator) -> Tensor:
    """Hues turned, paled, scaled and shifted; some negative. Affine, ``(3, 4)``."""
    turn, paled, scaled, shifted, negated = torch.rand(5, generator=rng).tolist()
    grey = torch.full((3, 3), 1 / 3)
    cross = torch.tensor([[0.0, -1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 1.0, 0.0]]) / math.sqrt(3)
    cos, sin = math.cos(2 * math.pi * turn), math.sin(2 * math.pi * turn)
    turned = cos * torch.eye(3) + (1 - cos) * grey + sin * cross  # about the axis of greys
    saturation = _between(SATURATION, paled)
    mix = (saturation * torch.eye(3) + (1 - saturation) * grey) @ turned
    mix = _between(CONTRAST, scaled) * mix
    offset = torch.full((3, 1), _between(BRIGHTNESS, shifted))
    if negated < NEGATIVE:
        mix, offset = -mix, 1 - offset
    return torch.cat((mix, offset), 1)


def _between(bounds: tuple[float, float], share: float) -> float:
    return bounds[0] + (bounds[1] - bounds[0]) * share
