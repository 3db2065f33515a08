"""Forces of the harder scenes, by their numbers; what divides them by the masses is in `scenes`.

None of this is code that diagnoses: the truth is made apart from what is to find it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vidphys.experiments.confusion.scenes import Law

STILL = 1e-3  # world units per second, below which dry friction is smoothed
WALL = 1500.0  # stiffness of a wall, newtons per world unit


def held(stiffness: np.ndarray | float, centre: tuple[float, float]) -> Law:
    """A trap; ``stiffness`` a number, or a matrix ``(2, 2)`` where directions differ."""
    matrix = stiffness * np.eye(2) if np.ndim(stiffness) == 0 else np.asarray(stiffness)
    return lambda q, v, t: -(q - np.array(centre)) @ matrix


def weight(field: np.ndarray, mass: np.ndarray) -> Law:
    """A constant acceleration of all bodies."""
    return lambda q, v, t: np.broadcast_to(field * mass[:, None], q.shape)


def resisted(rate: float, power: int) -> Law:
    """Friction that goes with this power of the speed."""

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        speed = np.sqrt((v**2).sum(-1, keepdims=True) + STILL**2)
        return -rate * v * speed ** (power - 1)

    return law


def resisted_by_place(rate: float) -> Law:
    """Linear friction that grows with the distance from the origin."""
    return lambda q, v, t: -rate * (0.2 + (q**2).sum(-1, keepdims=True)) * v


def resisted_unevenly(rates: tuple[float, float]) -> Law:
    """Linear friction that differs between the axes."""
    return lambda q, v, t: -np.array(rates) * v


def carried(rate: float, gradient: np.ndarray) -> Law:
    """Linear friction against air that flows, with a speed that is linear in the place."""
    return lambda q, v, t: -rate * (v - q @ gradient.T)


def pushed(way: np.ndarray, when: float, lasting: float) -> Law:
    """The same push on all bodies, which comes and goes about a time."""
    return lambda q, v, t: np.broadcast_to(way * np.exp(-(((t - when) / lasting) ** 2)), q.shape)


def across(strength: float) -> Law:
    """A force across the velocity."""
    return lambda q, v, t: strength * np.stack([v[..., 1], -v[..., 0]], -1)


def walled(half: float) -> Law:
    """The four steep walls of a box of this half side."""
    return lambda q, v, t: -WALL * (q - np.clip(q, -half, half))


def between(shape: Callable[[np.ndarray], np.ndarray], weights: np.ndarray | None = None) -> Law:
    """Attraction of each two bodies, ``shape`` of their distance times the vector between them.

    Args:
        shape: of distances ``(e, n, n, 1)``; what it gives a body and itself counts for nothing.
        weights: ``(n, n)``, what each two forces are multiplied by.
    """

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        apart = q[:, None] - q[:, :, None]
        distance = np.sqrt((apart**2).sum(-1, keepdims=True))
        factor = 1.0 if weights is None else weights[..., None]
        return (apart * shape(distance + np.eye(q.shape[1])[..., None] * 1e9) * factor).sum(2)

    return law


def following(rate: float, reach: float) -> Law:
    """Friction between each two bodies, by their speed past each other, while they are near."""

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        apart = q[:, None] - q[:, :, None]
        near = np.exp(-0.5 * (apart**2).sum(-1, keepdims=True) / reach**2)
        return rate * (near * (v[:, None] - v[:, :, None])).sum(2)

    return law


def powered(strength: float, softening: float, power: float) -> Callable[[np.ndarray], np.ndarray]:
    """A softened force that falls as this power of the distance."""
    return lambda r: strength * (r**2 + softening**2) ** (-(power + 1) / 2)


def cut_off(strength: float, reach: float) -> Callable[[np.ndarray], np.ndarray]:
    """A force that ends, smoothly, where bodies are this far apart."""
    return lambda r: strength * np.maximum(1 - (r / reach) ** 2, 0) ** 2


def touching(stiffness: float, diameter: float) -> Callable[[np.ndarray], np.ndarray]:
    """Soft disks: a spring between those that overlap."""
    return lambda r: -stiffness * np.maximum(diameter / r - 1, 0)


def varying(law: Law, rate: float) -> Law:
    """A law whose strength changes with time."""
    return lambda q, v, t: (1 + np.sin(rate * t)) * law(q, v, t)


def three_together(strength: float) -> Law:
    """A force of each three bodies: the product of their nearness enters, no sum over pairs."""

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        apart = q[:, None] - q[:, :, None]
        near = np.exp(-0.5 * (apart**2).sum(-1)) * (1 - np.eye(q.shape[1]))
        others = near.sum(-1, keepdims=True) - near  # of all third bodies
        return 2 * strength * (apart * (near * others)[..., None]).sum(2)

    return law
