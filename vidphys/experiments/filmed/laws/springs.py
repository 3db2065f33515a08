"""Masses on springs, along a line: one, or two with a spring between them."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.law import Law


def _one(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """A displacement from rest along a direction ``(x, y)``; the damping is of velocity (1/s)."""
    omega, damping, x, y, start = numbers
    half = damping / 2
    ringing = np.sqrt(omega**2 - half**2)
    swing = np.cos(ringing * times) + half / ringing * np.sin(ringing * times)
    along = start * np.exp(-half * times) * swing
    return along[:, None, None] * np.array([x, y])


SPRING = Law(("omega", "damping", "x", "y", "start"), _one)


def _two(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Wall, spring, mass, spring, mass, spring, wall; stiffnesses over the first mass (1/s^2)."""
    first, between, second, ratio, damping, apart, start1, start2 = numbers
    mass = np.array([[1.0, 1.0], [ratio, ratio]])
    stiff = np.array([[first + between, -between], [-between, between + second]]) / mass
    matrix = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiff, -damping * np.eye(2)]])
    values, vectors = np.linalg.eig(matrix)
    begin = np.linalg.solve(vectors, np.array([start1, start2, 0.0, 0.0]).astype(complex))
    moved = ((vectors @ (begin[:, None] * np.exp(values[:, None] * times))).real)[:2].T
    across = moved + np.array([0.0, apart])
    return np.stack([across, np.zeros_like(across)], -1)


TWO_MASSES = Law(
    ("first", "between", "second", "mass_ratio", "damping", "apart", "start1", "start2"), _two
)
