"""A22: the friction rate from the balance of energy, over frame rates and noise of positions."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np
import torch
from torch import Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, rollout
from dynamics.findings import DynamicsWarning
from dynamics.friction import Friction
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.weak.energy_balance import corrected_rate
from vidphys.stress.bodies import STEP
from vidphys.stress.case import SOUND, WARNED, Case

RATE = 1.5  # per second, of the friction
INTERVALS = (0.01, 0.02, 0.04, 0.08)  # seconds between frames
NOISES = (0.0, 0.005, 0.02)  # world units, of each coordinate
SOFTENINGS = (0.3, 0.1)  # world units; at 0.1 close encounters are faster than slow frames
SEEDS, CLIPS, BODIES, FRAMES = 3, 64, 3, 24
BIAS, EXACT = 0.1, 0.01  # of the rate
WIDE = 0.05  # half an interval over the true rate: from here on no confident number


class WideIntervalWarning(DynamicsWarning):
    """The estimator's own interval says that the rate is not known well, and holds the truth."""


def energy_balance() -> Iterator[Case]:
    """Where the bias is bounded, and where the interval must say that nothing is known."""
    cell = partial(Case, "energy balance", path="numpy", figure="A22")
    every = product(SOFTENINGS, INTERVALS, NOISES, range(SEEDS))
    for softening, interval, noise, seed in every:
        known = softening == SOFTENINGS[0] and _promised(interval, noise)
        bound = EXACT if known and not noise and interval <= 0.04 else BIAS
        system = f"three bodies, softening {softening:g}"
        extreme = f"{interval:g} s, noise {noise:g}, seed {seed}"
        run = partial(_bias, softening, interval, noise, seed)
        must = (SOUND,) if known else (SOUND, WARNED)
        yield cell(system, extreme, interval, run, bound, must=must)


def _promised(interval: float, noise: float) -> bool:
    """Whether the bias is bounded, or a wide interval is an answer too."""
    return not noise or interval == 0.08 or (interval == 0.04 and noise <= 0.005)


def _bias(softening: float, interval: float, noise: float, seed: int) -> float:
    """Error of the rate, over the rate."""
    q = _positions(softening, interval, seed)
    q = q + noise * np.random.default_rng(seed).standard_normal(q.shape)
    motion = motion_of(q, interval)
    law = SoftenedGravity(softening)

    def potential(places: np.ndarray) -> np.ndarray:
        where = torch.from_numpy(places)
        one = torch.ones(where.shape[:-2], dtype=torch.float64)
        return law.energy(
            where, Parameters(one, one.unsqueeze(-1).expand(where.shape[:-1]))
        ).numpy()

    found = corrected_rate(motion, potential)
    wide = found.high - found.low > 2 * WIDE * RATE
    if wide and found.low <= RATE <= found.high:
        text = f"rate {found.value:.3g}, between {found.low:.3g} and {found.high:.3g}"
        warnings.warn(text, WideIntervalWarning, stacklevel=1)
    return abs(found.value / RATE - 1)


def _positions(softening: float, interval: float, seed: int) -> np.ndarray:
    """True positions at the frames, ``(clips, frames, bodies, 2)``."""
    rng = torch.Generator().manual_seed(seed)
    q, v = torch.randn(2, CLIPS, BODIES, 2, generator=rng, dtype=torch.float64)
    start = PhaseState(q, 0.5 * v).map(lambda x: x - x.mean(1, keepdim=True))
    one = torch.ones(CLIPS, dtype=torch.float64)
    params = Parameters(one, one.unsqueeze(-1).expand(CLIPS, BODIES))
    ports = [Friction("linear", "known")]
    law = Hamiltonian(FixedKinetic(), SoftenedGravity(softening), ports=ports)
    every = round(interval / STEP)
    steps = every * (FRAMES - 1)
    run = rollout(law, start, params.with_scalar("friction", RATE), steps, STEP, every)
    return run.states.map(Tensor.double).q.numpy()
