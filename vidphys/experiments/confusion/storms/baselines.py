"""Baselines of the harder scenes. Each may refuse: where its residual is more than the noise."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.inference.menu import FRICTIONS, Term, external_terms, field_of, pair_terms
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.noise import measure_noise
from vidphys.diagnose.weak.paths import smooth
from vidphys.diagnose.weak.regression import rows_of
from vidphys.diagnose.weak.windows import Windows, cut_windows
from vidphys.experiments.confusion.scores import (
    Answer,
    grouped,
    misfit_of,
    names_of,
    thresholded,
)

FRAMES = 16  # of a window of test functions
REFUSES = 2.0  # residual over the noise's variance, from which it says "none of these"
FULL = frozenset({"uniform", "trap", "linear", "square", "dry", "pair"})


def weak_sindy(motion: Motion) -> Answer:
    """Weak-form SINDy: PySINDy's thresholded least squares on our weak rows and columns.

    Paths are local polynomials, the noise is taken to be white, and the shape of the pair force is
    the one that fits best; thresholds are chosen by Akaike's criterion.
    """
    windows, sigma = cut_windows(motion, FRAMES), measure_noise(motion).sigma
    terms, x, y = _weak(motion, windows, sigma)
    scaled = x / np.sqrt((x**2).mean(0) + 1e-24)
    found = thresholded(scaled, y)
    kinds = grouped(names_of(terms, motion.space), found)
    return Answer(kinds, _quiet(y - scaled @ found, sigma))


def full_menu(motion: Motion) -> Answer:
    """Every term that the bodies allow, if together they leave no more than the noise."""
    windows, sigma = cut_windows(motion, FRAMES), measure_noise(motion).sigma
    _, x, y = _weak(motion, windows, sigma)
    left = y - x @ np.linalg.lstsq(x, y, rcond=None)[0]
    return Answer(FULL if motion.bodies > 1 else FULL - {"pair"}, _quiet(left, sigma))


def _weak(
    motion: Motion, windows: Windows, sigma: float
) -> tuple[list[Term], np.ndarray, np.ndarray]:
    """Terms, their weak columns ``(r, p)`` and what the frames say ``(r,)``."""
    field = field_of(windows, smooth(windows, max(sigma, 1e-6)))
    fixed = [external_terms(motion.space, False)[1], *FRICTIONS.values()]
    tried = [fixed]
    if motion.bodies > 1:
        tried = [[*fixed, pair] for pair in pair_terms(field.distance, "alike")]
    best = None
    for terms in tried:
        rows = rows_of(windows, np.concatenate([t.columns(field) for t in terms], -1))
        left = misfit_of(rows.x, rows.y)
        if best is None or left < best[0]:
            best = left, terms, rows
    assert best is not None
    return best[1], best[2].x, best[2].y


def _quiet(left: np.ndarray, sigma: float) -> bool:
    return bool((left**2).mean() <= REFUSES * sigma**2)
