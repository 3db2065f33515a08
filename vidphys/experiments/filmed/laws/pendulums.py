"""Pendulums: one, two joined by a spring, and one hung from the other; places of the bobs.

Angles are from straight down, radians, and grow to the right.
"""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.law import GRAVITY, Law, integrate


def _hang(length: float | np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Places below a pivot, ``(…, 2)``."""
    return np.stack([length * np.sin(angle), -length * np.cos(angle)], -1)


def _swing(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """One bob: linear damping is of its velocity (1/s), squared drag of its speed (1/m)."""
    length, damping, drag, angle, rate = numbers

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        a, w = state
        lost = damping * w + drag * length * abs(w) * w
        return np.array([w, -GRAVITY / length * np.sin(a) - lost])

    return _hang(length, integrate(slope, np.array([angle, rate]), times)[:, 0])[:, None]


PENDULUM = Law(("length", "damping", "drag", "angle", "rate"), _swing)


def _apart(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    first, second = _swing(numbers[:5], times), _swing(numbers[5:10], times)
    return np.concatenate([first, second + [numbers[10], numbers[11]]], 1)


TWO_PENDULUMS = Law(
    (
        *(f"{name}1" for name in PENDULUM.names),
        *(f"{name}2" for name in PENDULUM.names),
        "aside",
        "above",
    ),
    _apart,
)


def _joined(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Two equal bobs on equal strings, a spring between them that is slack when both hang."""
    length, damping, stiffness, aside, first, second = numbers
    away = np.array([aside, 0.0])

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        angles, rates = state[:2], state[2:]
        places = _hang(length, angles)
        between = places[1] + away - places[0]
        far = np.sqrt((between**2).sum())
        pull = stiffness * (far - aside) * between / far
        along = np.stack([np.cos(angles), np.sin(angles)], -1)
        forces = (along * np.stack([pull, -pull])).sum(-1) / length
        return np.concatenate([rates, forces - GRAVITY / length * np.sin(angles) - damping * rates])

    angles = integrate(slope, np.array([first, second, 0.0, 0.0]), times)[:, :2]
    return _hang(length, angles) + np.stack([np.zeros(2), away])


COUPLED_PENDULUMS = Law(("length", "damping", "stiffness", "aside", "angle1", "angle2"), _joined)


def _chained(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Two point masses on weightless rods, the second hung from the first; no friction."""
    upper, lower, ratio, first, second = numbers

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        a, b, wa, wb = state
        c, s = np.cos(a - b), np.sin(a - b)
        weight = 1 + ratio
        mass = np.array([[weight * upper, ratio * lower * c], [upper * c, lower]])
        force = np.array(
            [
                -ratio * lower * wb**2 * s - weight * GRAVITY * np.sin(a),
                upper * wa**2 * s - GRAVITY * np.sin(b),
            ]
        )
        return np.concatenate([[wa, wb], np.linalg.solve(mass, force)])

    angles = integrate(slope, np.array([first, second, 0.0, 0.0]), times)
    inner = _hang(upper, angles[:, 0])
    return np.stack([inner, inner + _hang(lower, angles[:, 1])], 1)


DOUBLE_PENDULUM = Law(("length1", "length2", "mass_ratio", "angle1", "angle2"), _chained)
