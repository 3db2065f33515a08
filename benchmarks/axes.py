"""What grows, along which axis, and beside which peer; see :mod:`benchmarks.growth`."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch

from benchmarks.contenders import DT, episodes, fitted
from benchmarks.encoders import dinov2_small
from benchmarks.extraction import opener, plain_loop, write_clip
from benchmarks.training import together_and_apart
from dynamics import Hamiltonian, Parameters, terms
from dynamics.compiled import compile_head
from dynamics.contact import SoftContact
from dynamics.neighbours import WithinReach
from dynamics.potentials import SoftenedGravity
from dynamics.tree import BarnesHut
from encoders.frozen import DINOv2Settings
from encoders.store import FeatureStore
from renderers import Camera, gaussians
from vidphys.data.ahead import ahead
from vidphys.data.many import Wanted, extract_many
from vidphys.runs.pool import run_all

Work = Callable[[], object]
BODIES = (3, 16, 64, 256, 1024, 4096)
SIGMA = 0.32  # world units, of a splat in a view that is 8 wide
CELL_SECONDS = 0.25  # of the processor, of a cell that is made to measure what runs it
CELLS, WORKERS = 16, 2


@dataclass(frozen=True)
class Axis:
    """What grows.

    Args:
        sizes: along it.
        work: what is done at a size.
        peer: what it is held beside, and its work at a size.
        most: the peer's largest size; all, where there is none.
        clock: that it is timed by, seconds.
    """

    sizes: Sequence[int]
    work: Callable[[int], Work]
    peer: tuple[str, Callable[[int], Work]] | None = None
    most: int | None = None
    clock: Callable[[], float] = time.process_time


def _crowd(count: int) -> tuple[torch.Tensor, Parameters]:
    """Bodies at the same density however many they are."""
    rng = torch.Generator().manual_seed(count)
    q = count**0.5 * torch.randn(count, 2, generator=rng)
    return q, Parameters(torch.ones(()), torch.full((count,), 1.0 / count))


def _forced(law: Any, count: int) -> Work:
    q, params = _crowd(count)
    return lambda: law.force(q, params)


def _broadcast(count: int) -> Work:
    """Every body with every body, as a script would write it."""
    q, params = _crowd(count)

    def force() -> torch.Tensor:
        apart = q[:, None] - q
        pull = params.mass / (apart.square().sum(-1) + 0.1**2) ** 1.5
        return -params.mass[:, None] * (pull[..., None] * apart).sum(1)

    return force


@cache
@torch.enable_grad()
def _law() -> Hamiltonian:
    return fitted(terms.Radial(width=64))


@cache
def _compiled() -> Hamiltonian:
    return compile_head(_law())


def _rolled(count: int, steps: int) -> Work:
    start, params = episodes(count)
    return lambda: _compiled().trajectory(start, params, steps, DT)


def _scanned(count: int, steps: int) -> Work:
    from benchmarks import peers  # which are installed for benchmarks alone

    start, params = episodes(count)
    phi = _law().potential.phi  # type: ignore[attr-defined]
    return peers.jax_leapfrog(peers.radial_gradient, phi, start, params, steps, DT)


def _places(frames: int) -> torch.Tensor:
    return 6.0 * (torch.rand(frames, 3, 2, generator=torch.Generator().manual_seed(0)) - 0.5)


def _drawn(frames: int, side: int) -> Work:
    q = _places(frames)
    return lambda: gaussians(q, Camera(4.0, side, side), SIGMA)


def _naive(frames: int, side: int) -> Work:
    q, camera = _places(frames), Camera(4.0, side, side)

    def draw() -> torch.Tensor:
        dx = camera.xs() - q[..., 0, None, None]
        dy = camera.ys()[:, None] - q[..., 1, None, None]
        return torch.exp(-(dx**2 + dy**2) / (2 * SIGMA**2))

    return draw


def _with_gradients(work: Work) -> Work:
    return torch.enable_grad()(work)


def _trained(together: bool, seeds: int) -> Work:
    return _with_gradients(together_and_apart(seeds, 64, 256)[0 if together else 1])


@cache
def _encoder() -> Any:
    return dinov2_small(DINOv2Settings(batch=4))


def _frames(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    rng = torch.Generator().manual_seed(0)
    pixels = torch.rand(1, count, 3, 112, 112, generator=rng)
    return pixels, torch.arange(count, dtype=torch.float64)


def _spread_layers(count: int) -> tuple[int, ...]:
    """So many of the encoder's layers, at even distances, the last among them."""
    layers = _encoder().layers
    return tuple(layers[round((i + 1) * len(layers) / count) - 1] for i in range(count))


def _one_pass(count: int) -> Work:
    (pixels, times), layers = _frames(4), _spread_layers(count)
    return lambda: _encoder().encode_layers(pixels, times, layers)


def _pass_a_layer(count: int) -> Work:
    (pixels, times), layers = _frames(4), _spread_layers(count)
    return lambda: [_encoder().at(layer)(pixels, times) for layer in layers]


@cache
def _clips(count: int) -> tuple[Path, ...]:
    folder = Path(tempfile.mkdtemp(prefix="vidphys-benchmark-"))
    return tuple(write_clip(folder / f"{seed}.avi", seed) for seed in range(count))


def _extracted(count: int) -> Work:
    files, layer = _clips(count), _encoder().identity.layer

    def extract() -> None:
        with tempfile.TemporaryDirectory() as folder:
            wanted = Wanted(_encoder(), (layer,), FeatureStore(Path(folder)))
            extract_many(ahead([opener(file) for file in files]), wanted, lambda *_: None)

    return extract


def _saved(count: int) -> Work:
    return partial(plain_loop, _clips(count), _encoder().network, 4)


def cell(report: object = None) -> None:
    """Work of a fixed cost on one core."""
    until = time.process_time() + CELL_SECONDS
    while time.process_time() < until:
        pass


def _by_engine(cells: int, workers: int) -> Work:
    return lambda: run_all(cell, [()] * cells, workers, lambda _: None, lambda _: None)


def _by_pool(cells: int, workers: int) -> Work:
    def work() -> None:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            for one in [pool.submit(cell) for _ in range(cells)]:
                one.result()

    return work


GRAVITY, TOUCH = SoftenedGravity(0.1), WithinReach(SoftContact(0.5), 1.0)
MANY = (*BODIES, 16_384, 65_536)
SCRIPT, JAX, NAIVE = "every body with every body", "JAX scan, its network", "naive torch"
AXES = {
    "bodies, all pairs (a force)": Axis(BODIES, partial(_forced, GRAVITY), (SCRIPT, _broadcast)),
    "bodies, far ones as groups (a force)": Axis(MANY, partial(_forced, BarnesHut(GRAVITY, 0.5))),
    "bodies, pairs within reach (a force)": Axis(MANY, partial(_forced, TOUCH)),
    "episodes (100 steps)": Axis(
        (1, 8, 64, 512, 4096, 32_768),
        lambda n: _rolled(n, 100),
        (JAX, lambda n: _scanned(n, 100)),
        512,
    ),
    "steps (16 episodes)": Axis(
        (100, 1000, 10_000, 100_000),
        lambda n: _rolled(16, n),
        (JAX, lambda n: _scanned(16, n)),
        10_000,
    ),
    "pixels of a side (16 frames)": Axis(
        (16, 64, 128, 256, 512, 1024), partial(_drawn, 16), (NAIVE, partial(_naive, 16))
    ),
    "frames (112 px)": Axis(
        (8, 64, 512, 2048), lambda n: _drawn(n, 112), (NAIVE, lambda n: _naive(n, 112))
    ),
    "seeds (a training step)": Axis(
        (1, 2, 4, 8, 16, 32),
        partial(_trained, True),
        ("one after another", partial(_trained, False)),
    ),
    "layers of an encoder (4 frames)": Axis(
        (1, 2, 3, 6, 12), _one_pass, ("a pass a layer", _pass_a_layer)
    ),
    "clips (6 frames, by the clock)": Axis(
        (1, 4, 16), _extracted, ("a loop that saves arrays", _saved), clock=time.monotonic
    ),
    "cells (a quarter of a second each, two workers)": Axis(
        (2, 8, 32, 128),
        lambda n: _by_engine(n, WORKERS),
        ("the standard library's pool", lambda n: _by_pool(n, WORKERS)),
        32,
        clock=time.monotonic,
    ),
    "workers (sixteen such cells)": Axis(
        (1, 2, 4),
        lambda n: _by_engine(CELLS, n),
        ("the standard library's pool", lambda n: _by_pool(CELLS, n)),
        clock=time.monotonic,
    ),
}
