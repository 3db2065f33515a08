"""Targets by name: the quantities of mechanics, and any column of a clip's table.

A quantity is read from its own columns where the table has them, and else derived: velocity and
acceleration by differences of positions in time, force as mass times acceleration.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from registry import Registry
from vidphys.probing.targets import Kind, Target
from vidphys.probing.truth import Truth

STILL = 0.05  # of the median speed: below it a body has no direction
TOUCHING = 0.7  # world units: two radii of a disk as `render` draws them


def position(truth: Truth) -> np.ndarray:
    """``(t, 2n)``, world units."""
    return _flat(truth.positions())


def velocity(truth: Truth) -> np.ndarray:
    """``(t, 2n)``, world units a second."""
    return _flat(_velocities(truth))


def speed(truth: Truth) -> np.ndarray:
    """``(t, n)``, world units a second."""
    return np.linalg.norm(_velocities(truth), axis=-1)


def direction(truth: Truth) -> np.ndarray:
    """``(t, n)``, radians from the x axis; not known of a body that hardly moves."""
    moving = _velocities(truth)
    fast = np.linalg.norm(moving, axis=-1)
    angle = np.arctan2(moving[..., 1], moving[..., 0])
    return np.where(fast > STILL * np.nanmedian(fast), angle, np.nan)


def acceleration(truth: Truth) -> np.ndarray:
    """``(t, 2n)``, world units a second squared."""
    return _flat(_accelerations(truth))


def force(truth: Truth) -> np.ndarray:
    """``(t, 2n)``, the force on each body, friction and drive among it."""
    if truth.has("fx", "fy"):
        return _flat(truth.of_bodies("fx", "fy"))
    return _flat(truth.of_bodies("m") * _accelerations(truth))


def momentum(truth: Truth) -> np.ndarray:
    """``(t, 2n)``."""
    if truth.has("px", "py"):
        return _flat(truth.of_bodies("px", "py"))
    return _flat(truth.of_bodies("m") * _velocities(truth))


def mass(truth: Truth) -> np.ndarray:
    """``(t, n)``, the same in all frames."""
    return _flat(truth.of_bodies("m"))


def charge(truth: Truth) -> np.ndarray:
    """``(t, n)``, the same in all frames."""
    return _flat(truth.of_bodies("z"))


def coupling(truth: Truth) -> np.ndarray:
    """``(t, 1)``, the strength of the law, the same in all frames."""
    return truth.column("coupling").astype(float)[:, None]


def contact(truth: Truth) -> np.ndarray:
    """``(t, 1)``: whether any two bodies are within :data:`TOUCHING` of each other."""
    places = truth.positions()
    pairs = combinations(range(places.shape[1]), 2)
    apart = [np.linalg.norm(places[:, i] - places[:, j], axis=-1) for i, j in pairs]
    if not apart:
        raise ValueError("a single body touches no other")
    return (np.min(apart, 0) < TOUCHING).astype(float)[:, None]


def count(truth: Truth) -> np.ndarray:
    """``(t, 1)``: how many bodies have a known place."""
    return np.isfinite(truth.positions()).all(-1).sum(1).astype(float)[:, None]


def of_column(name: str) -> Target:
    """Any column of numbers, by its name."""
    return _column(name, "regression")


def of_angles(name: str) -> Target:
    """Any column of angles in radians, by its name."""
    return _column(f"angle:{name}", "circular")


def of_classes(name: str) -> Target:
    """Any column of classes, by its name."""
    return _column(f"class:{name}", "classification")


def _column(name: str, kind: Kind) -> Target:
    _, _, bare = name.rpartition(":")

    def read(truth: Truth) -> np.ndarray:
        values = truth.column(bare)
        if kind != "classification" and values.dtype.kind not in "fiub":
            raise ValueError(f"its values are words, such as {values[0]!s:.40}; ask class:{bare}")
        return values[:, None]

    return Target(name, kind, "frame", read)


def _velocities(truth: Truth) -> np.ndarray:
    """``(t, n, 2)``."""
    if truth.has("vx", "vy"):
        return truth.of_bodies("vx", "vy")
    return _slope(truth.positions(), truth.times)


def _accelerations(truth: Truth) -> np.ndarray:
    """``(t, n, 2)``."""
    if truth.has("fx", "fy", "m"):
        return truth.of_bodies("fx", "fy") / truth.of_bodies("m")
    return _slope(_velocities(truth), truth.times)


def _slope(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """By central differences in time, one-sided at the ends."""
    if len(times) < 3:
        raise ValueError(f"differences in time need at least 3 frames, got {len(times)}")
    return np.gradient(values, times, axis=0)


def _flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), -1)


TARGETS: Registry[Target] = Registry(
    "target",
    "vidphys.targets",
    {"column": of_column, "angle": of_angles, "class": of_classes},
)
for _target in (
    Target("position", "regression", "body", position),
    Target("velocity", "regression", "body", velocity),
    Target("speed", "regression", "body", speed),
    Target("direction", "circular", "body", direction),
    Target("acceleration", "regression", "body", acceleration),
    Target("force", "regression", "body", force),
    Target("momentum", "regression", "body", momentum),
    Target("mass", "regression", "clip", mass),
    Target("charge", "classification", "clip", charge),
    Target("coupling", "regression", "clip", coupling),
    Target("contact", "classification", "frame", contact),
    Target("count", "classification", "frame", count),
):
    TARGETS.register(_target.name, _target)
