"""Confusion scenes: motions whose law is known, to be told apart from noisy positions alone.

The truth is integrated here, with none of the code that diagnoses it. Most scenes have terms of
the menu; a fifth has something that the menu lacks and must be answered by "none of these".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.recordings.motion import Motion, motion_of

CLIPS, FRAMES = 8, 64
FINE = 0.01  # seconds, at most, of a step of the reference integrator
SOFTENING, GRAVITY = 0.3, 1.0
TRAP, CENTRE = 1.5, (0.3, -0.2)
FIELD = (0.0, -0.8)
LINEAR, SQUARE, DRY, DRIVE, BATH = 0.4, 0.5, 0.25, 0.25, 1.0
TEMPERATURE = 0.3
CONTACT, DIAMETER = 40.0, 0.7
MAGNETIC, ROTATED, UNEVEN = 1.0, 0.6, (0.1, 0.9)
MEMORY, MEMORY_SECONDS = 1.5, 0.7
TRIPLE = 2.0

Law = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


@dataclass(frozen=True)
class Kind:
    """A class of scenes.

    Args:
        name: of the class.
        law: acceleration from places and velocities ``(e, n, d)`` and the time.
        truth: kinds of terms that must be found; ``None`` where the menu has no such scene.
        bodies: numbers of bodies that it may have.
        speed: standard deviation of the first velocities, per axis.
        noise: standard deviation of random kicks, per square root of a second; of all bodies, or
            of each, ``(n, 1)``.
        spread: standard deviation of the first places, per axis.
    """

    name: str
    law: Law
    truth: frozenset[str] | None
    bodies: tuple[int, ...] = (1, 2, 3, 5, 8)
    speed: float = 0.7
    noise: float | np.ndarray = 0.0
    spread: float = 1.0


def free(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """No force."""
    return np.zeros_like(q)


def uniform(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """A constant force."""
    return np.broadcast_to(np.array(FIELD), q.shape)


def trapped(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """A harmonic trap."""
    return -TRAP * (q - np.array(CENTRE))


def pairs(shape: Callable[[np.ndarray], np.ndarray]) -> Law:
    """A force along the line between any two bodies; ``shape`` takes the squared distance."""

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        apart = q[:, None] - q[:, :, None]
        return (apart * shape((apart**2).sum(-1, keepdims=True))).sum(2)

    return law


attracted = pairs(lambda squared: GRAVITY * (squared + SOFTENING**2) ** -1.5)
repelled = pairs(lambda squared: -GRAVITY * (squared + SOFTENING**2) ** -1.5)
bound = pairs(lambda squared: np.ones_like(squared))


def touching(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """Soft disks: a spring between those that overlap."""
    apart = q[:, None] - q[:, :, None]
    distance = np.sqrt((apart**2).sum(-1, keepdims=True)) + np.eye(q.shape[1])[..., None] * 1e9
    return -(apart * CONTACT * np.maximum(DIAMETER / distance - 1, 0)).sum(2)


def drag(rate: float, power: int) -> Law:
    """Friction that goes with this power of the speed."""

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        # Dry friction of a body at rest is whatever keeps it there: smoothed below 1e-3.
        speed = np.sqrt((v**2).sum(-1, keepdims=True) + 1e-6)
        return -rate * v * speed ** (power - 1)

    return law


linear, square, dry = drag(LINEAR, 1), drag(SQUARE, 2), drag(DRY, 0)
driven, bathed = drag(-DRIVE, 1), drag(BATH, 1)


def magnetic(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """A force across the velocity."""
    return MAGNETIC * np.stack([v[..., 1], -v[..., 0]], -1)


def waning(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """A pair force whose strength changes with time."""
    return (1 + np.sin(2.5 * t)) * attracted(q, v, t)


def uneven(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """Friction that differs between the axes."""
    return -np.array(UNEVEN) * v


def triple(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """A force of each three bodies: their sides' product enters, no sum over pairs does."""
    total = np.zeros_like(q)
    for i in range(q.shape[1]):
        for j in range(q.shape[1]):
            for k in range(j):
                if i in (j, k):
                    continue
                first, second = q[:, j] - q[:, i], q[:, k] - q[:, i]
                near = np.exp(-0.5 * ((first**2).sum(-1) + (second**2).sum(-1)))[:, None]
                total[:, i] += TRIPLE * near * (first + second)
    return total


def one_sided(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
    """Who follows is not followed: a force along the line of two bodies without its reaction."""
    weight = np.where(np.arange(q.shape[1]) % 2 == 0, 1.5, -1.0)
    apart = q[:, None] - q[:, :, None]
    shape = ((apart**2).sum(-1, keepdims=True) + SOFTENING**2) ** -1.5
    return (apart * shape * weight[None, None, :, None]).sum(2)


def total(*laws: Law) -> Law:
    """The sum of several laws."""
    return lambda q, v, t: sum((law(q, v, t) for law in laws), np.zeros_like(q))


def _kicked(rate: float) -> float:
    """Strength of kicks that hold a friction of this rate at the temperature."""
    return float(np.sqrt(2 * rate * TEMPERATURE))


MANY = (2, 3, 5, 8)
KINDS = {
    kind.name: kind
    for kind in (
        Kind("inertial", free, frozenset()),
        Kind("projectile", uniform, frozenset({"uniform"})),
        Kind("trap", trapped, frozenset({"trap"})),
        Kind("drag", linear, frozenset({"linear"}), speed=1.0),
        Kind("falling-drag", total(uniform, linear), frozenset({"uniform", "linear"})),
        Kind("trap-drag", total(trapped, linear), frozenset({"trap", "linear"})),
        Kind("trap-square", total(trapped, square), frozenset({"trap", "square"})),
        Kind("trap-dry", total(trapped, dry), frozenset({"trap", "dry"})),
        Kind("trap-drive", total(trapped, driven), frozenset({"trap", "drive"})),
        Kind("gravity", attracted, frozenset({"pair"}), MANY),
        Kind("repulsion", repelled, frozenset({"pair"}), MANY),
        Kind("springs", bound, frozenset({"pair"}), MANY),
        Kind("gravity-drag", total(attracted, linear), frozenset({"pair", "linear"}), MANY),
        Kind("gravity-square", total(attracted, square), frozenset({"pair", "square"}), MANY),
        Kind("gravity-field", total(attracted, uniform), frozenset({"pair", "uniform"}), MANY),
        Kind("repulsion-trap", total(repelled, trapped), frozenset({"pair", "trap"}), MANY),
        Kind("disks-trap", total(touching, trapped), frozenset({"contact", "trap"}), MANY),
        Kind(
            "langevin",
            total(trapped, bathed),
            frozenset({"trap", "linear", "bath"}),
            noise=_kicked(BATH),
        ),
        Kind(
            "langevin-pairs",
            total(attracted, trapped, bathed),
            frozenset({"pair", "trap", "linear", "bath"}),
            MANY,
            noise=_kicked(BATH),
        ),
        Kind("outside-magnetic", total(trapped, magnetic), None),
        Kind("outside-waning", waning, None, MANY),
        Kind("outside-uneven", uneven, None, speed=1.0),
        Kind("outside-triple", triple, None, (3, 5, 8)),
        Kind("outside-one-sided", one_sided, None, MANY),
    )
}


@dataclass(frozen=True)
class Setting:
    """How a scene was recorded: noise (world units), seconds between frames, bodies, seed."""

    sigma: float
    interval: float
    bodies: int
    seed: int


def record(kind: Kind, setting: Setting, clips: int = CLIPS, frames: int = FRAMES) -> Motion:
    """Clips of a scene as a tracker would deliver them."""
    path = path_of(kind, setting, clips, frames)
    noise = np.random.default_rng([setting.seed, 7]).standard_normal(path.shape)
    return motion_of(path + setting.sigma * noise, setting.interval)


def path_of(kind: Kind, setting: Setting, clips: int = CLIPS, frames: int = FRAMES) -> np.ndarray:
    """True places ``(e, t, n, d)``, world units; the setting's noise is left out."""
    rng = np.random.default_rng([setting.seed, setting.bodies, *kind.name.encode()])
    shape = (clips, setting.bodies, 2)
    q = kind.spread * _apart(shape, rng)
    v = kind.speed * rng.standard_normal(shape)
    fine = max(1, int(np.ceil(setting.interval / FINE)))
    stored = [q]
    for frame in range(1, frames):
        for part in range(fine):
            t = setting.interval * (frame - 1 + part / fine)
            q, v = _step(kind, q, v, t, setting.interval / fine, rng)
        stored.append(q)
    return np.stack(stored, 1)


def _apart(shape: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    """Places, drawn again where two bodies begin closer than a softening."""
    q = rng.standard_normal(shape)
    for _ in range(100):
        apart = np.linalg.norm(q[:, None] - q[:, :, None], axis=-1) + 9 * np.eye(shape[1])
        bad = apart.min((1, 2)) < SOFTENING
        if not bad.any():
            break
        q[bad] = rng.standard_normal((int(bad.sum()), *shape[1:])) * np.sqrt(shape[1] / 2 + 0.5)
    return q


def _step(
    kind: Kind, q: np.ndarray, v: np.ndarray, t: float, dt: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Runge and Kutta's step of fourth order, between two halves of the random kicks."""
    if np.any(kind.noise):
        v = v + kind.noise * np.sqrt(dt / 2) * rng.standard_normal(v.shape)
    a1 = kind.law(q, v, t)
    q2, v2 = q + dt / 2 * v, v + dt / 2 * a1
    a2 = kind.law(q2, v2, t + dt / 2)
    q3, v3 = q + dt / 2 * v2, v + dt / 2 * a2
    a3 = kind.law(q3, v3, t + dt / 2)
    q4, v4 = q + dt * v3, v + dt * a3
    a4 = kind.law(q4, v4, t + dt)
    q, v = q + dt / 6 * (v + 2 * v2 + 2 * v3 + v4), v + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    if np.any(kind.noise):
        v = v + kind.noise * np.sqrt(dt / 2) * rng.standard_normal(v.shape)
    return q, v
