"""Bodies that fly, fall, bounce and roll."""

from __future__ import annotations

import numpy as np

from vidphys.experiments.filmed.laws.law import GRAVITY, Law, integrate


def _toss(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Free flight from the origin."""
    across, up = numbers
    return np.stack([across * times, up * times - GRAVITY / 2 * times**2], -1)[:, None]


TOSS = Law(("across", "up"), _toss)


def _bounce(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Flights above a floor at height 0, each begun with ``restitution`` of the speed before.

    A ball whose bounces have died out lies still in height.
    """
    restitution, height, across, up = numbers
    fall = np.sqrt(up**2 + 2 * GRAVITY * height)
    begin, speed, low = 0.0, up, height
    heights = np.zeros_like(times)
    while begin <= times.max() and (speed > 1e-4 or low > 0):  # a trial may gain at each bounce
        lasts = (up + fall) / GRAVITY if low > 0 else 2 * speed / GRAVITY
        since = times - begin
        here = (since >= 0) & (since < lasts)
        heights[here] = (low + speed * since - GRAVITY / 2 * since**2)[here]
        speed = restitution * (fall if low > 0 else speed)
        begin, low = begin + lasts, 0.0
    return np.stack([across * times, heights], -1)[:, None]


BOUNCE = Law(("restitution", "height", "across", "up"), _bounce)


def _line(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Constant acceleration along a direction; a body that friction stops stays."""
    acceleration, speed, x, y = numbers
    if acceleration < 0:
        times = np.minimum(times, -speed / acceleration)
    along = speed * times + acceleration / 2 * times**2
    return along[:, None, None] * np.array([x, y])


ROLL = Law(("acceleration", "speed", "x", "y"), _line)


def _drag(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """A fall from the origin against drag that grows as the square of the speed (1/m)."""
    drag, across, up = numbers

    def slope(_: float, state: np.ndarray) -> np.ndarray:
        v = state[2:]
        return np.concatenate([v, [0.0, -GRAVITY] - drag * np.sqrt((v**2).sum()) * v])

    return integrate(slope, np.array([0.0, 0.0, across, up]), times)[:, None, :2]


DRAG = Law(("drag", "across", "up"), _drag)
