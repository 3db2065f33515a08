"""Classes that are on no menu and that nobody tunes on; measured on confirmation seeds alone.

One that fails again and again is moved to those that may be tuned on, and another takes its place.
"""

from __future__ import annotations

import numpy as np

from vidphys.experiments.confusion.scenes import Law, total
from vidphys.experiments.confusion.storms import forces
from vidphys.experiments.confusion.storms.scenes import MANY, Class, Draw


def _quartic(d: Draw) -> Law:
    strength = d.strength(1.0)
    return lambda q, v, t: -strength * (q**2).sum(-1, keepdims=True) * q


def _limit_cycle(d: Draw) -> Law:
    rate = d.strength(0.6)
    held = forces.held(d.strength(1.5), (0.0, 0.0))
    return total(held, lambda q, v, t: rate * (1 - (q**2).sum(-1, keepdims=True)) * v)


def _shaken(d: Draw) -> Law:
    way, rate = d.field(), d.strength(3.0)
    return total(
        forces.held(d.strength(1.5), d.place()),
        lambda q, v, t: np.broadcast_to(way * np.sin(rate * t), q.shape),
    )


def _wind(d: Draw) -> Law:
    rate, shear = d.strength(0.6), d.strength(0.8)

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        air = np.stack([shear * q[..., 1], np.zeros_like(q[..., 0])], -1)
        return -rate * (v - air)

    return law


def _swirl(d: Draw) -> Law:
    strength, reach = d.strength(1.0), d.length(1.0)

    def law(q: np.ndarray, v: np.ndarray, t: float) -> np.ndarray:
        apart = q[:, None] - q[:, :, None]
        near = np.exp(-0.5 * (apart**2).sum(-1, keepdims=True) / reach**2)
        across = np.stack([-apart[..., 1], apart[..., 0]], -1)
        return strength * (near * across).sum(2)

    return law


def _charged(d: Draw) -> Law:
    charge = np.where(np.arange(len(d.mass)) % 2 == 0, 1.0, -1.0) * d.strength(1.0)
    pull = forces.powered(-1.0, d.length(0.3), 2.0)
    return forces.between(pull, np.outer(charge, charge))


UNLISTED = {
    some.name: some
    for some in (
        Class("unlisted-quartic", _quartic, None),
        Class("unlisted-limit-cycle", _limit_cycle, None),
        Class("unlisted-shaken", _shaken, None),
        Class("unlisted-wind", _wind, None),
        Class("unlisted-swirl", _swirl, None, MANY),
        Class("unlisted-charged", _charged, None, (3, 5)),
    )
}
