"""Motion in space that stays in a plane, as a planet's, or on a line: its places in that plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from vidphys.diagnose.recordings.motion import Motion

SPACE = 3  # dimensions
THIN = 0.02  # of the longest extent, which the motion leaves the plane by at most
PLAIN = 0.1  # of its other extent in the plane: on a line no plane shows
UPRIGHT = 0.9  # cosine between the plane's normal and z, from which z does not lie along the plane


def in_its_plane(motion: Motion) -> tuple[Motion, np.ndarray] | None:
    """The same motion by two coordinates, along the plane's axes ``(2, 3)``.

    Coordinates count from the origin, where it shows in the plane. The second axis is as near to z
    as the plane allows; in a plane that is nearly level the first one is as near to x.

    Args:
        motion: of any bodies.

    Returns:
        ``None`` where the bodies do not stay in one plane of space, or on a line.
    """
    shape = _shape(motion)
    if shape is None:
        return None
    extents, axes = shape
    if extents[2] > min(THIN * extents[0], PLAIN * extents[1]):
        return None
    normal = axes[2] * (1.0 if axes[2, 2] >= 0 else -1.0)
    level = normal[2] > UPRIGHT
    asked = np.eye(SPACE)[0 if level else 2]
    found = asked - (asked @ normal) * normal
    found /= np.linalg.norm(found)
    both = np.stack([found, np.cross(normal, found)] if level else [np.cross(found, normal), found])
    return laid(motion, both), both


def on_its_line(motion: Motion) -> tuple[Motion, np.ndarray] | None:
    """Motion along a line of space, as of riders on a track, by one coordinate along it ``(1, 3)``.

    Returns:
        As :func:`in_its_plane`; ``None`` where the bodies leave the line.
    """
    shape = _shape(motion)
    if shape is None or shape[0][1] > THIN * shape[0][0]:
        return None
    along = shape[1][:1] * np.sign(shape[1][0, np.abs(shape[1][0]).argmax()])
    return laid(motion, along), along


def _shape(motion: Motion) -> tuple[np.ndarray, np.ndarray] | None:
    """How far all places reach along the axes of their own, and these; ``None`` in a plane."""
    if motion.space != SPACE:
        return None
    places = motion.positions[motion.seen]
    extents, axes = np.linalg.svd(places - places.mean(0), full_matrices=False)[1:]
    return extents, axes


def laid(motion: Motion, axes: ArrayLike | None) -> Motion:
    """The same motion by its coordinates along the axes of a plane or line of space ``(d, 3)``.

    What is not in space stays as it is, and so does everything where there is no plane.
    """
    if axes is None or motion.space != SPACE:
        return motion
    return replace(motion, positions=motion.positions @ np.asarray(axes).T)
