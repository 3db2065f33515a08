"""The reference: a least-squares fit of the right law, begun at the truth."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from vidphys.experiments.filmed.scenes.kinds import KINDS
from vidphys.experiments.filmed.truth import Truth

ROUNDS = 12  # of the solver
DIRECTIONS = ("x", "y")  # which the plane's embedding can turn as well
SLIP = 1.0  # pixels, beyond which a place counts less


def forecast_by_hand(truth: Truth, track: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Places ``(t, n, 2)`` in pixels by the scene's own law, fitted to some frames of a track.

    The law's numbers and an affine embedding of its plane in the picture are free; gravity and
    numbers that are not part of the law (those that are nothing) are not.

    Args:
        truth: gives the law, and where the fit begins.
        track: pixels, ``(t, n, 2)``; NaN where a body was not seen.
        fitted: which frames, ``(t,)``; those before the release never are.
    """
    law = KINDS[truth.kind](np.random.default_rng(0)).law
    values = np.array([truth.values[name] for name in law.names])
    free = np.array([name not in DIRECTIONS for name in law.names])
    free &= (values != 0) | np.array([name.startswith(("angle", "rate")) for name in law.names])
    since = truth.times - truth.released
    holds = since >= 0
    used = (fitted & holds)[holds]
    seen = np.isfinite(track[holds]).all(-1) & used[:, None]
    unique, back = np.unique(since[holds], return_inverse=True)

    def places(numbers: np.ndarray, plane: np.ndarray) -> np.ndarray:
        return _embedded(law.path(numbers, unique)[back], plane)

    def residual(x: np.ndarray) -> np.ndarray:
        numbers = values.copy()
        numbers[free] = x[6:]
        return (places(numbers, x[:6]) - track[holds])[seen].ravel()

    start = np.concatenate(
        [_plane(law.path(values, unique)[back], truth.steady[holds]), values[free]]
    )
    found = least_squares(
        residual, start, x_scale="jac", loss="soft_l1", f_scale=SLIP, max_nfev=ROUNDS
    ).x
    numbers = values.copy()
    numbers[free] = found[6:]
    told = np.full(truth.steady.shape, np.nan)
    told[holds] = places(numbers, found[:6])
    return told


def _embedded(metres: np.ndarray, plane: np.ndarray) -> np.ndarray:
    return metres @ plane[:4].reshape(2, 2) + plane[4:]


def _plane(metres: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """The affine map ``(6,)`` that comes nearest, of a line the one that keeps its angles."""
    x, y = metres.reshape(-1, 2).T
    zero, one = np.zeros_like(x), np.ones_like(x)
    # pixels' rows go down: a mirrored similarity (a, b, c, d)
    rows = np.stack([np.stack([x, y, one, zero], -1), np.stack([-y, x, zero, one], -1)], 1)
    target = pixels.reshape(-1, 2) * [1, -1]
    (a, b, c, d), *_ = np.linalg.lstsq(rows.reshape(-1, 4), target.ravel(), rcond=None)
    return np.array([a, b, b, -a, c, -d])
