"""Two marks on one rigid body that flies and turns: read as its centre of mass, which has a law."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.units import Units

STEADY = 0.12  # of the marks' distance, by which it may vary: each is marked a little wrong
OFTEN = 0.9  # of the frames, in which both are seen
TURNS = 2.0  # that are seen at least
EVENLY = 0.05  # of the angle that is seen, by which the spin may differ from one that fades
BENT = 0.5  # of the marks' distance, by which the centre's way is no straight one: it flies
HANGING = 0.05  # of its radius, by which a mark that hangs from a pivot leaves its circle


def as_rigid(motion: Motion, units: Units) -> tuple[Motion, tuple[str, ...]]:
    """The motion of the centre of mass, where two tracks are marks of one body that flies.

    Two bodies that circle each other keep their distance too, but their centre goes straight on;
    of two rods that hang end on end one mark stays on a circle.

    Args:
        motion: of any bodies.
        units: in which the distance is told.

    Returns:
        That motion, or the given one, and what a person should know.
    """
    if (motion.clips, motion.bodies, motion.space) != (1, 2, 2):
        return motion, ()
    both = motion.seen[0].all(-1)
    times, (one, two) = motion.times[0, both], motion.positions[0, both].transpose(1, 0, 2)
    away = two - one
    apart = np.linalg.norm(away, axis=-1)
    if both.mean() < OFTEN or not apart.std() < STEADY * apart.mean():
        return motion, ()
    angle = np.unwrap(np.arctan2(away[:, 1], away[:, 0]))
    rate, fades, off = _spin(times - times[0], angle)
    if np.ptp(angle) < 2 * np.pi * TURNS or off > EVENLY * np.ptp(angle):
        return motion, ()
    share = _centre(one, away)
    straight = np.polynomial.polynomial.polyfit(times, one + share * away, 1)
    bent = one + share * away - np.polynomial.polynomial.polyval(times, straight).T
    if np.linalg.norm(bent, axis=-1).max() < BENT * apart.mean() or _hangs(one) or _hangs(two):
        return motion, ()
    first, second = motion.positions[:, :, :1], motion.positions[:, :, 1:]
    centre = first + share * (second - first)
    said = (
        f"bodies 1 and 2 stay {units.length(float(apart.mean()))} apart and turn: read as marks on "
        "one rigid body, of which the centre of mass is followed, "
        f"{share:.2f} of the way from 1 to 2; it turns by {rate:.4g} rad/s at first, "
        f"and loses {fades:.2g} of that a second"
    )
    weight = motion.mass.sum(1, keepdims=True) if np.ptp(motion.mass) else motion.mass[:, :1]
    return replace(motion, positions=centre, mass=weight, spin_fades=max(fades, 0.0)), (said,)


def _spin(since: np.ndarray, angle: np.ndarray) -> tuple[float, float, float]:
    """Rate at first and the share of it lost a second, of a spin that fades; and what it misses."""

    def missed(x: np.ndarray) -> np.ndarray:
        start, rate, fades = x
        faded = -np.expm1(-fades * since) / fades if fades else since
        return start + rate * faded - angle

    slope = (angle[-1] - angle[0]) / since[-1]
    found = least_squares(missed, [angle[0], slope, 0.1 / since[-1]], x_scale="jac")
    return float(found.x[1]), float(found.x[2]), float(np.std(found.fun))


def _centre(one: np.ndarray, away: np.ndarray) -> float:
    """How far along the way to the other mark the place lies that does not turn, 0 to 1."""
    shaken, turned = np.diff(one, n=2, axis=0), np.diff(away, n=2, axis=0)
    return float(np.clip(-(shaken * turned).sum() / (turned**2).sum(), 0.0, 1.0))


def _hangs(places: np.ndarray) -> bool:
    """Whether a mark goes to and fro, or all the way round, on a circle."""
    x = places - places.mean(0)
    design = np.column_stack([2 * x, np.ones(len(x))])
    found = np.linalg.lstsq(design, (x**2).sum(1), rcond=None)[0]  # Kasa 1976
    radii = np.linalg.norm(x - found[:2], axis=1)
    if not radii.std() < HANGING * radii.mean():
        return False
    angle = np.unwrap(np.arctan2(*(x - found[:2]).T[::-1]))
    return bool(np.ptp(angle) > np.pi or abs(angle[-1] - angle[0]) < 0.5 * np.ptp(angle))
