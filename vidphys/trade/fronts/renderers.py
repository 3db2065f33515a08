"""Drawing: world, size, antialiasing and memory, against where the drawn bodies are."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor

from renderers import (
    AnonymousWorld,
    Camera,
    ChannelWorld,
    centroids,
    disks,
    gaussians,
    supersampled,
)
from vidphys.trade.context import Context
from vidphys.trade.measure import Job, Scale

SCALE = Scale(
    "drawing",
    "us_per_frame",
    1e6,
    "centroid_error",
    "true positions; world units, root mean square over bodies, from frames rounded to bytes",
)
FACTORS = (1, 2, 4)
EXACT = 8  # samples along a pixel's side that stand for its whole area
INSIDE = 2.5  # world units: bodies whose light is whole


def jobs(context: Context) -> Iterator[Job]:
    """Each world and size, supersampled or not, into fresh or into the caller's memory."""
    rng = context.rng("drawing")
    q = INSIDE * (2 * torch.rand(context.sizes.frames, 1, 2, generator=rng) - 1)
    for size in context.sizes.image_sizes:
        camera = Camera(height=size, width=size)
        for name, world in _worlds(camera).items():
            exact = supersampled(world, EXACT)(q.double())
            for factor in FACTORS:
                if factor * size <= max(context.sizes.image_sizes):
                    draw = supersampled(world, factor)
                    yield _job(name, size, factor, "fresh", q, draw, world, exact)
            yield _job(name, size, 1, "reused", q, _into_memory(world, q), world, exact)


def _worlds(camera: Camera) -> dict[str, ChannelWorld | AnonymousWorld]:
    """Those in which the picture of one body is one splat."""
    return {"channels": ChannelWorld(camera), "anonymous": AnonymousWorld(camera)}


def _into_memory(world: ChannelWorld | AnonymousWorld, q: Tensor) -> Callable[[Tensor], Tensor]:
    """One body a frame, so that the splat is the picture."""
    camera = world.camera
    memory = torch.empty(*q.shape[:-1], camera.height, camera.width)
    if isinstance(world, ChannelWorld):
        return lambda x: gaussians(x, camera, world.sigma, memory)
    return lambda x: disks(x, camera, world.radius, world.softness, memory)


def _job(
    name: str,
    size: int,
    factor: int,
    memory: str,
    q: Tensor,
    draw: Callable[[Tensor], Tensor],
    world: ChannelWorld | AnonymousWorld,
    exact: Tensor,
) -> Job:
    def errors(frames: Tensor) -> dict[str, float]:
        stored = (frames.double() * 255).round() / 255
        found, _ = centroids(stored, world.camera)
        return {
            "centroid_error": float((found - q).square().sum(-1).mean().sqrt()),
            "frame_error": float((frames - exact).square().mean().sqrt()),
        }

    return Job(
        task=f"one body, {name}",
        configuration={"world": name, "image": size, "antialias": factor, "memory": memory},
        work=lambda: draw(q),
        errors=errors,
        per_call=len(q),
        dtype="float32",
        units={"bytes": 4.0 * size * size, "pixels": float((factor * size) ** 2)},
    )
