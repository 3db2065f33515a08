"""Benchmark rows of splats: naive torch and kornia, forward and backward, and memory's own speed.

Every variant gives the same frames: three bodies, each in a channel of its own. The peers are timed
as a script would run them, where each batch of pictures is fresh memory, and in rows of their own
with memory kept in the process; see :mod:`vidphys.trade.memory`.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from benchmarks.match import Contender, Match
from renderers import Camera, disks, gaussians
from vidphys.trade.memory import keep_memory

SIZE, BODIES, FRAMES = 224, 3, 128
SIGMA, RADIUS, SOFTNESS = 0.32, 0.4, 0.05  # world units, of a view that is 8 wide
PLACES = 6.0  # world units: bodies lie in a square of this side
OURS = "numba, reused memory"
PICTURES = "three bodies, each drawn into a channel of its own, float32"
Draw = Callable[[Tensor], Tensor]


def _drawn(kind: str, bar: float, both: bool = False, kept: bool = False) -> Match:
    """Pictures of one kind.

    Args:
        kind: ``gaussians``, or soft ``disks``.
        bar: least ratio of speed.
        both: with the gradient of the bodies' places.
        kept: where the peers' memory is kept in the process; any ratio above 1 counts.
    """
    if kept:
        keep_memory()
    case = Case.drawn()
    row = f"{kind} {'with backward' if both else 'forward'}{', memory kept' if kept else ''}"
    if kind == "disks":
        return case.match(row, case.disks, {"naive torch": case.naive_disks}, bar, both)
    return case.match(row, case.gaussians, case.gaussian_peers(), bar, both)


gaussians_forward = partial(_drawn, "gaussians", 30.0)
gaussians_backward = partial(_drawn, "gaussians", 30.0, both=True)
gaussians_kept = partial(_drawn, "gaussians", 1.0, both=True, kept=True)
disks_forward = partial(_drawn, "disks", 20.0)
disks_backward = partial(_drawn, "disks", 20.0, both=True)
disks_kept = partial(_drawn, "disks", 1.0, both=True, kept=True)


def gaussians_bandwidth() -> Match:
    """Bytes of Gaussian splats a second against filling the same memory with one number."""
    case = Case.drawn()
    size = float(case.memory.numel() * case.memory.element_size())
    one = "the same bytes set to one number"
    fill = Contender(lambda: case.memory.fill_(0.5), size, "torch", one)
    ours = Contender(case.work(case.gaussians, False), size, OURS, PICTURES)
    return Match("gaussians forward, bytes", "bytes", ours, {"fill_ of the memory": (fill, 0.5)})


@dataclass(frozen=True)
class Case:
    """Places of bodies, what they are drawn into, and a gradient from above."""

    q: Tensor
    camera: Camera
    memory: Tensor
    upstream: Tensor

    @classmethod
    def drawn(cls) -> Case:
        rng = torch.Generator().manual_seed(0)
        q = PLACES * (torch.rand(FRAMES, BODIES, 2, generator=rng) - 0.5)
        shape = (FRAMES, BODIES, SIZE, SIZE)
        upstream = torch.randn(shape, generator=rng)
        return cls(q, Camera(4.0, SIZE, SIZE), torch.empty(shape), upstream)

    def match(
        self, row: str, ours: Draw, peers: Mapping[str, Draw], bar: float, both: bool
    ) -> Match:
        what = PICTURES + (", and the gradient of their places" if both else "")
        against = {
            name: (Contender(self.work(draw, both), FRAMES, "torch", what), bar)
            for name, draw in peers.items()
        }
        return Match(row, "frames", Contender(self.work(ours, both), FRAMES, OURS, what), against)

    def work(self, draw: Draw, both: bool) -> Callable[[], object]:
        """One batch of frames; with the gradient of the places where ``both``."""

        def forward() -> object:
            with torch.no_grad():
                return draw(self.q)

        def backward() -> object:
            q = self.q.clone().requires_grad_()
            return torch.autograd.grad(draw(q), q, self.upstream)

        return backward if both else forward

    def gaussians(self, q: Tensor) -> Tensor:
        return gaussians(q, self.camera, SIGMA, self.memory)

    def disks(self, q: Tensor) -> Tensor:
        return disks(q, self.camera, RADIUS, SOFTNESS, self.memory)

    def gaussian_peers(self) -> dict[str, Draw]:
        peers: dict[str, Draw] = {"naive torch": self.naive_gaussians}
        if importlib.util.find_spec("kornia") is not None:
            peers["kornia + einsum"] = self.kornia
        return peers

    def naive_gaussians(self, q: Tensor) -> Tensor:
        dx, dy = self._offsets(q)
        return torch.exp(-(dx**2 + dy**2) / (2 * SIGMA**2))

    def naive_disks(self, q: Tensor) -> Tensor:
        """The edge as a sigmoid of the distance: the same disk but for its far tail."""
        dx, dy = self._offsets(q)
        return torch.sigmoid((RADIUS - (dx**2 + dy**2 + 1e-12).sqrt()) / SOFTNESS)

    def _offsets(self, q: Tensor) -> tuple[Tensor, Tensor]:
        xs, ys = (side(q.dtype, q.device) for side in (self.camera.xs, self.camera.ys))
        return xs - q[..., 0, None, None], ys[:, None] - q[..., 1, None, None]

    def kornia(self, q: Tensor) -> Tensor:
        """Each body by the library, composed into channels by its colour."""
        from kornia.geometry.subpix import render_gaussian2d

        places = self.camera.to_pixel(q).reshape(-1, 2)
        width = torch.full_like(places, SIGMA / self.camera.units_per_pixel)
        bodies = render_gaussian2d(places, width, (SIZE, SIZE), False)
        bodies = bodies.view(FRAMES, BODIES, SIZE, SIZE)
        return torch.einsum("bnhw,nc->bchw", bodies, torch.eye(BODIES))
