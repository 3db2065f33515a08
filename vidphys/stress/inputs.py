"""Numbers that are none, and precisions that are too coarse, at every boundary: refused by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product

import torch
from torch import Tensor

from binders.detect import detect
from binders.palette import track_by_palette
from dynamics import Parameters, PhaseState, rollout
from readouts.soft_argmax import soft_argmax
from renderers import AnonymousWorld, Camera, ChannelWorld, RgbWorld, centroids
from vidphys.stress.bodies import STEP, Orbit
from vidphys.stress.case import REFUSED, Case

SIDE = 8
FIELDS = ("q", "p", "coupling", "mass", "charge", "electric", "dt")


def inputs() -> Iterator[Case]:
    """A10 and A30."""
    cell = partial(Case, "input", value=1.0, bound=0.0, dtype="any", must=(REFUSED,))
    spoiled = partial(cell, integrator="leapfrog", figure="A30")
    for value in (math.nan, math.inf, -math.inf):
        for field, path in product(FIELDS, ("eager", "batched")):
            run = partial(_spoiled, field, value, path == "batched")
            yield spoiled("rollout", f"{field} is {value}", run=run, path=path)
        for name, read in READERS.items():
            run = partial(_run, read, value)
            yield spoiled(name, f"a number is {value}", run=run, path="frames")
    for dtype, name in product((torch.float16, torch.bfloat16), ("leapfrog", "yoshida4", "rk4")):
        run = partial(_coarse, dtype, name)
        yield cell("rollout", f"state in {dtype}", run=run, integrator=name, figure="A10")


def _run(read: Callable[[float], object], value: float) -> float:
    read(value)
    return math.inf


def _spoiled(field: str, value: float, batched: bool) -> float:
    start, params = Orbit(0.0, 0.1).start(torch.float64, 3 if batched else 0)
    charges = torch.ones_like(params.mass)
    params = Parameters(params.coupling, params.mass, charges).with_scalar("electric", 1.0)
    parts = {
        "q": start.q,
        "p": start.p,
        "coupling": params.coupling,
        "mass": params.mass,
        "charge": charges,
        "electric": params.scalar("electric"),
    }
    dt = value if field == "dt" else STEP
    if field != "dt":
        spoiled = parts[field].clone()
        spoiled.view(-1)[-1] = value
        parts[field] = spoiled
    law = Parameters(
        parts["coupling"], parts["mass"], parts["charge"], {"electric": parts["electric"]}
    )
    rollout(Orbit(0.0, 0.1).law("leapfrog"), PhaseState(parts["q"], parts["p"]), law, 5, dt)
    return math.inf


def _coarse(dtype: torch.dtype, integrator: str) -> float:
    start, params = Orbit(0.0, 0.1).start(torch.float64)
    rollout(Orbit(0.0, 0.1).law(integrator), start.map(lambda x: x.to(dtype)), params, 5, STEP)
    return math.inf


def _frames(value: float, channels: int) -> Tensor:
    frames = torch.zeros(1, 3, channels, SIDE, SIDE)
    frames[0, 1, 0, 2, 3] = value
    return frames


def _camera() -> Camera:
    return Camera(4.0, SIDE, SIDE)


def _seen_by_detector(value: float) -> object:
    camera, world = _camera(), AnonymousWorld()
    frames = _frames(value, 1)
    return detect(frames, torch.arange(3.0), 1, world.coverage, camera.xs(), camera.ys())


def _seen_by_palette(value: float) -> object:
    camera = _camera()
    colours, disk = ((1.0, 0.0, 0.0),), AnonymousWorld(radius=0.35).coverage
    times = torch.arange(3.0)
    return track_by_palette(_frames(value, 3), times, colours, disk, camera.xs(), camera.ys())


def _heat(value: float) -> object:
    camera = _camera()
    centres = torch.stack(torch.meshgrid(camera.ys(), camera.xs(), indexing="ij")[::-1], -1)
    return soft_argmax(_frames(value, 1)[0, 1], centres)


READERS: dict[str, Callable[[float], object]] = {
    "channel world": lambda x: ChannelWorld(_camera())(torch.tensor([[x, 0.0]])),
    "coloured world": lambda x: RgbWorld(_camera())(torch.tensor([[x, 0.0]])),
    "anonymous world": lambda x: AnonymousWorld(_camera())(torch.tensor([[x, 0.0]])),
    "centroid": lambda x: centroids(_frames(x, 1)[0, 1], _camera()),
    "detector": _seen_by_detector,
    "palette": _seen_by_palette,
    "soft-argmax": _heat,
}
