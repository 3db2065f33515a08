"""Bodies whose common centre of mass moves as if nothing from outside turned it."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

BALANCED = 0.1  # share of the motion that their centre may keep beside a parabola
HARDLY = 0.02  # of what moves most, below which a body's motion says nothing of its mass
HEAVY = 1e5  # times another's mass, that what hardly moves is taken for at most
UNLIKE = 1.2  # times the least distance from it, that the largest is at least: others tell of none


def masses_in_balance(motion: Motion) -> np.ndarray | None:
    """Masses ``(n,)``, of mean one in the logarithm, whose centre goes straight on or falls.

    The centre does so of bodies that act on each other, where nothing else acts on them but a
    uniform field. Bodies that have each a law of their own keep such a balance only by chance.

    Returns:
        ``None`` where no masses do so, or a body hardly moves beside a parabola of its own.
    """
    if motion.bodies < 2:
        return None
    left = _left(motion)
    moves = np.linalg.norm(left, axis=0)
    if len(left) < motion.bodies or not moves.min() > HARDLY * moves.max():
        return None
    _, size, ways = np.linalg.svd(left / moves, full_matrices=False)
    mass = ways[-1] / moves * np.sign(ways[-1].sum())
    if size[-1] > BALANCED or not (mass > 0).all():
        return None
    return _of_mean_one(mass)


def about_a_heavy_one(motion: Motion) -> np.ndarray | None:
    """Masses ``(n,)``, of mean one in the logarithm, of bodies that may go round one of them.

    What little the heavy one moves tells how heavy it is beside each of the others.

    Returns:
        ``None`` where not one body hardly moves beside each of the others, or those keep their
        distance from it: they tell nothing of a pull that falls off.
    """
    left = _left(motion)
    moves = np.linalg.norm(left, axis=0)
    heavy = int(moves.argmin())
    others = np.arange(motion.bodies) != heavy
    if motion.bodies < 2 or not moves[heavy] < HARDLY * moves[others].min():
        return None
    apart = motion.positions[:, :, others] - motion.positions[:, :, [heavy]]
    distance = np.linalg.norm(apart, axis=-1)
    if not np.nanmax(distance) > UNLIKE * np.nanmin(distance):
        return None
    mass = np.ones(motion.bodies)
    shares = -np.linalg.lstsq(left[:, others], left[:, heavy], rcond=None)[0]
    mass[others] = np.maximum(shares, 1 / HEAVY)
    return _of_mean_one(mass)


def _of_mean_one(mass: np.ndarray) -> np.ndarray:
    return np.asarray(mass / np.exp(np.log(mass).mean()))


def _left(motion: Motion) -> np.ndarray:
    """What parabolas leave of bodies' places in all clips, ``(c, n)``."""
    clips = zip(motion.times, motion.positions, strict=True)
    return np.concatenate([_beside_parabolas(*clip) for clip in clips])


def _beside_parabolas(times: np.ndarray, path: np.ndarray) -> np.ndarray:
    """What parabolas leave of bodies' places where all are seen, ``(t d, n)``."""
    seen = np.isfinite(path).all((1, 2))
    path = path[seen]
    basis = np.vander(times[seen] - times.mean(), 3)
    ways = np.moveaxis(path, 1, -1)  # (t, d, n)
    return np.concatenate(
        [x - basis @ np.linalg.lstsq(basis, x, rcond=None)[0] for x in np.moveaxis(ways, 1, 0)]
    )
