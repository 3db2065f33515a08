"""The reference: a least-squares fit of the right law, begun at the truth."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from vidphys.experiments.filmed.scenes.kinds import KINDS
from vidphys.experiments.filmed.truth import Truth

ROUNDS = 12  # of the solver
ENOUGH = 1e-4  # relative change of the misfit at which it ends
NUDGE = 1e-4  # of its slopes, relative
DIRECTIONS = ("x", "y")  # which the embedding can turn as well
SLIP = 1.0  # pixels, beyond which a place counts less
LOST = 1e4  # such, of a motion that cannot be
GUESSED = 0.3  # relative; how well a person knows the numbers beforehand
TILTED = 0.2  # a metre; the plane's perspective that a person thinks of
PLANE = 8  # numbers of the embedding


def forecast_by_hand(truth: Truth, track: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Places ``(t, n, 2)`` in pixels by the scene's own law, fitted to some frames of a track.

    The law's numbers and a perspective view of its plane are free, held loosely to what a person
    would guess; gravity is known, and terms that the scene does not have are left out.

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
    seen = np.isfinite(track[holds]).all(-1) & fitted[holds, None]
    unique, back = np.unique(since[holds], return_inverse=True)

    def places(x: np.ndarray) -> np.ndarray:
        numbers = values.copy()
        numbers[free] = x[PLANE:]
        return _embedded(law.path(numbers, unique)[back], x[:PLANE])

    def residual(x: np.ndarray) -> np.ndarray:
        try:
            off = (places(x) - track[holds])[seen].ravel() / SLIP
        except FloatingPointError:  # numbers that no motion has
            off = np.full(2 * seen.sum(), LOST)
        steady = np.sign(off) * np.sqrt(2 * (np.sqrt(1 + off**2) - 1))
        return np.concatenate([steady, (x - start)[6:] / loose])

    view = truth.view / truth.view[2, 2]
    start = np.concatenate([view[0], view[1], view[2, :2], values[free]])
    start = start[[0, 1, 3, 4, 2, 5, 6, 7, *range(PLANE, len(start))]]
    known = np.maximum(GUESSED * np.abs(values[free]), GUESSED * NUDGE)
    loose = np.concatenate([np.full(PLANE - 6, TILTED), known])
    found = least_squares(
        residual, start, x_scale="jac", max_nfev=ROUNDS, ftol=ENOUGH, diff_step=NUDGE
    ).x
    told = np.full(truth.steady.shape, np.nan)
    told[holds] = places(found)
    return told


def _embedded(metres: np.ndarray, view: np.ndarray) -> np.ndarray:
    depth = 1 + metres @ view[6:]
    return (metres @ view[:4].reshape(2, 2).T + view[4:6]) / depth[..., None]
