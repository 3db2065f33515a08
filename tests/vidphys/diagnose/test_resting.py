"""Marks that rest while others move."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.recordings.resting import without_resting

T = np.arange(200) / 100
SWING = np.stack([0.5 * np.sin(4 * T), 0.1 * np.cos(8 * T)], 1)


def seen(*places: np.ndarray, noise: float = 2e-3) -> Motion:
    rng = np.random.default_rng(0)
    each = np.stack([np.broadcast_to(x, (200, 2)) for x in places], 1)
    return motion_of(each[None] + rng.normal(scale=noise, size=each.shape), 0.01)


def test_the_mark_of_a_pivot_is_left_out() -> None:
    found, (said,) = without_resting(seen([0.0, 0.5], SWING, [0.2, 0.1], noise=2e-3))
    assert found.bodies == 1 and np.ptp(found.positions[0, :, 0, 0]) > 0.9
    assert said.startswith("bodies 1 and 3 rest while others move: left out")
    _, (said,) = without_resting(seen(SWING, [0.0, 0.5], noise=0.0))
    assert said.startswith("body 2 rests")


def test_what_moves_little_but_smoothly_stays() -> None:
    """A star beside its planet, a puck before it is struck, and all of several that rest."""
    struck = np.maximum(T - 1.5, 0)[:, None] * [0.4, 0.1]
    for other in (0.02 * SWING, struck):
        assert without_resting(seen(SWING, other))[1] == ()
    still = seen([0.0, 0.0], [1.0, 1.0])
    assert without_resting(still)[0].bodies == 2
