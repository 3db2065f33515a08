"""Recordings of known motions: what was measured, and what a right answer says of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.experiments.filmed.laws.flights import BOUNCE
from vidphys.experiments.filmed.laws.law import GRAVITY
from vidphys.experiments.filmed.laws.pendulums import DOUBLE_PENDULUM, PENDULUM
from vidphys.experiments.filmed.scenes import flying
from vidphys.experiments.recorded.curves import BENT_TRAP, BOWL, SLACK

Random = np.random.Generator
PIXELS = 500.0  # a metre
MEMORY = 0.2  # seconds, of an error that lasts


@dataclass(frozen=True)
class Case:
    """A recording and its truth.

    Args:
        name: of what moves.
        motion: as it was measured.
        kinds: terms of a right answer; ``None`` where no term of the menu is right, so that only
            a formula is, or a refusal.
        numbers: of the truth, by the product's names, in its units.
    """

    name: str
    motion: Motion
    kinds: frozenset[str] | None
    numbers: Mapping[str, float] = field(default_factory=dict)


def measured(random: Random, path: np.ndarray, rate: float, white: float, smooth: float) -> Motion:
    """Tracks of places ``(t, n, d)``, with noise of these sizes in their unit.

    Args:
        random: of the noise.
        path: without it.
        rate: frames per second.
        white, smooth: standard deviations of what differs from frame to frame, and of what lasts.
    """
    noise = random.standard_normal(path.shape)
    slow, kept = random.standard_normal(path.shape), np.exp(-1 / (MEMORY * rate))
    for k in range(1, len(path)):
        slow[k] = kept * slow[k - 1] + np.sqrt(1 - kept**2) * slow[k]
    return motion_of((path + white * noise + smooth * slow)[None], 1 / rate)


def pixels(random: Random, path: np.ndarray, rate: float) -> Motion:
    """Tracks as a tracker measures them; half of them with an error that lasts."""
    smooth = float(random.choice([0.0, random.uniform(0.3, 1.5)]))
    return measured(random, PIXELS * path, rate, random.uniform(0.1, 0.8), smooth)


def pendulum(random: Random) -> Case:
    """A swing of 60 degrees."""
    length, damping = random.uniform(0.25, 0.9), random.uniform(0.03, 0.25)
    rate, seconds = float(random.choice([30, 60])), random.uniform(5, 7)
    times = np.arange(int(rate * seconds)) / rate
    path = PENDULUM.path(np.array([length, damping, 0, np.pi / 3, 0]), times)
    known = {"rate": np.sqrt(GRAVITY / length), "length": PIXELS * length}
    kinds = frozenset({"pendulum", "linear"})
    return Case("pendulum", pixels(random, path, rate), kinds, known)


def pucks(random: Random) -> Case:
    """Two discs of masses 1 to 3 that meet, at 100 Hz, known to half a millimetre."""
    scene, rate = flying.pucks(random), 100.0
    path = scene.law.path(np.array(scene.values), np.arange(int(scene.seconds * rate)) / rate)
    known = {"mass ratio": scene.values[0], "restitution": scene.values[1]}
    motion = measured(random, path, rate, 5e-4, 0.0)
    return Case("pucks", motion, frozenset({"collision"}), known)


def bounces(random: Random) -> Case:
    """A ball that bounces, at 30 to 120 frames per second."""
    scene, rate = flying.bounce(random), float(random.choice([30, 60, 120]))
    times = np.arange(int(scene.seconds * rate)) / rate
    path = BOUNCE.path(np.array(scene.values), times)
    known = {"restitution": scene.values[0], "acceleration": PIXELS * GRAVITY}
    kinds = frozenset({"uniform", "wall"})
    return Case("bounces", pixels(random, path, rate), kinds, known)


def bob(random: Random) -> Case:
    """One bob of a double pendulum: no law of one body moves it."""
    which = int(random.integers(2))
    lengths, ratio = random.uniform(0.2, 0.35, 2), random.uniform(0.2, 1.5)
    angles = np.radians(random.uniform(5, 70, 2)) * random.choice([-1, 1], 2)
    rate, seconds = float(random.choice([30, 60])), random.uniform(3, 6)
    times = np.arange(int(rate * seconds)) / rate
    path = DOUBLE_PENDULUM.path(np.array([*lengths, ratio, *angles]), times)[:, which : which + 1]
    return Case(("upper", "lower")[which] + " bob", pixels(random, path, rate), None)


def bowl(random: Random) -> Case:
    """A bead on a curve."""
    power = float(random.choice([2.0, 3.0, 4.0]))
    width, damping = random.uniform(0.2, 0.4), random.uniform(0.03, 0.25)
    numbers = np.array([random.uniform(0.1, 0.3), width, power, damping, width])
    rate = float(random.choice([30, 60]))
    path = BOWL.path(numbers, np.arange(int(6 * rate)) / rate)
    known = {"acceleration": PIXELS * GRAVITY, "linear friction": damping}
    kinds = frozenset({"curve", "linear", "uniform"})
    return Case("bowl", pixels(random, path, rate), kinds, known)


def slack(random: Random) -> Case:
    """A weight on a string that goes slack."""
    length, rate = random.uniform(0.25, 0.5), float(random.choice([30, 60]))
    speed = np.sqrt(GRAVITY * length * random.uniform(2.4, 4.4))
    numbers = np.array([length, random.uniform(0.03, 0.15), speed])
    path = SLACK.path(numbers, np.arange(int(4 * rate)) / rate)
    known = {"acceleration": PIXELS * GRAVITY, "length": PIXELS * length}
    kinds = frozenset({"string", "linear"})
    return Case("slack string", pixels(random, path, rate), kinds, known)


def bent_trap(random: Random) -> Case:
    """A potential that goes with ``|x|^1.5``, or another power that is no spring's."""
    power = float(random.choice([0.5, 0.5, 0.7, 1.5]))
    damping = float(random.choice([0.0, 0.05, 0.15]))
    numbers = np.array([random.uniform(3, 12), power, damping, random.uniform(0.2, 0.6)])
    path = BENT_TRAP.path(numbers, np.arange(400) / 50)
    motion = measured(random, path, 50.0, 0.005 * float(path.std()), 0.0)
    return Case("bent trap", motion, None)


CASES: Mapping[str, Callable[[Random], Case]] = {
    "pendulum": pendulum,
    "pucks": pucks,
    "bounces": bounces,
    "bob": bob,
    "bowl": bowl,
    "slack": slack,
    "bent-trap": bent_trap,
}
