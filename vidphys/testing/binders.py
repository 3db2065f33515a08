"""Whether a binder keeps its contract."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from typing import Any

import numpy as np
import torch

from binders import BINDERS, Binder, MotionTracks, Tracks
from vidphys.testing.failed import expect, expect_spoiled, pickled

FRAMES, HEIGHT, WIDTH, RADIUS = 24, 64, 96, 6
NEAR = 0.1  # normalised image units by which a followed body may be off


def check_binder(binder: str | Callable[..., Binder], bodies: int = 2) -> None:
    """Check a binder: everything that `train` and `diagnose` rely on where there are no tables.

    Disks of different colours on ways of their own before a still background are followed, each
    by one track, in normalised image units, at the clip's seconds, the same twice; a clip in which
    nothing is to be seen is refused, or followed with no confidence.

    Args:
        binder: a registered name, a ``package.module:factory``, or a factory, which is called with
            ``bodies``.
        bodies: that are shown.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    factory = BINDERS[binder] if isinstance(binder, str) else binder
    name = getattr(factory, "__name__", type(factory).__name__)
    made = pickled(factory(bodies=bodies), name)
    frames, places = moving_disks(bodies)
    times = np.arange(FRAMES) / 25
    found = _tracks(made(frames, times), name)
    shape, sure = (1, FRAMES, bodies, 2), found.confidence
    expect(tuple(found.positions.shape) == shape, name, shape, tuple(found.positions.shape))
    expect(tuple(sure.shape) == shape[:3], f"{name}: confidence", shape[:3], tuple(sure.shape))
    inside = bool(((sure >= 0) & (sure <= 1)).all())
    expect(inside, f"{name}: confidence", "within [0, 1]", sure.aminmax())
    same = np.allclose(found.times.numpy(), times, atol=1e-9)
    expect(same, f"{name}: times", "the seconds of the frames", found.times[:3].tolist())
    again = _tracks(made(frames, times), name)
    expect(torch.equal(found.positions, again.positions), name, "the same twice", "another answer")
    off = _least(found.positions[0].double().numpy(), places)
    expect(off < NEAR, name, "each track on one body, in normalised image units", f"{off:.2g} off")
    still = np.repeat(frames[:1], FRAMES, 0)
    expect_spoiled(lambda: _unsure(made(still, times), name), f"{name} where nothing moves")


def moving_disks(bodies: int) -> tuple[np.ndarray, np.ndarray]:
    """RGB bytes ``(t, H, W, 3)``, and the disks' places in normalised image units ``(t, n, 2)``."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    frames = np.full((FRAMES, HEIGHT, WIDTH, 3), 90, np.uint8)
    phase = np.linspace(0, 1, FRAMES)
    places = np.empty((FRAMES, bodies, 2))
    for body in range(bodies):
        row = (body + 0.5) * HEIGHT / bodies + 3 * np.sin(5 * phase + body)
        column = RADIUS + 2 + (WIDTH - 2 * RADIUS - 4) * (phase if body % 2 else 1 - phase)
        for frame in range(FRAMES):
            disk = np.hypot(u - column[frame], v - row[frame]) < RADIUS
            frames[frame, disk] = np.roll([240, 40, 20], body)
        centred = np.stack([column + 0.5 - WIDTH / 2, HEIGHT / 2 - row - 0.5], -1)
        places[:, body] = centred / (max(HEIGHT, WIDTH) / 2)
    return frames, places


def _tracks(found: Any, name: str) -> Tracks:
    known = isinstance(found, Tracks | MotionTracks)
    expect(known, name, "binders.Tracks or MotionTracks", type(found).__name__)
    return found.tracks if isinstance(found, MotionTracks) else found


def _least(found: np.ndarray, places: np.ndarray) -> float:
    """Largest distance from the true places, under the best order of the tracks."""
    orders = permutations(range(places.shape[1]))
    return min(float(np.linalg.norm(found[:, o] - places, axis=-1).max()) for o in orders)


def _unsure(found: Any, name: str) -> torch.Tensor:
    """Finite where the binder is sure of something that is not there."""
    sure = _tracks(found, name).confidence
    return torch.where(sure.max() > 0, sure, torch.nan)
