"""Scores of classes as probabilities, calibrated on clips that the readout had not seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax, softmax

STEEPEST = 50.0  # of the slope, for scores of deviation 1: surer than this nothing is
PRIOR = 1e-3  # pull of the offsets to zero, so that a class that never came has one
BINS = 10


@dataclass(frozen=True)
class Calibration:
    """Probabilities ``softmax(slope * scores + offsets)`` (Platt 1999, for several classes).

    Args:
        slope: never below zero: a score does not speak against its own class.
        offsets: of each class, ``(m,)``.
    """

    slope: float
    offsets: np.ndarray

    def __call__(self, scores: np.ndarray) -> np.ndarray:
        """Of scores ``(e, m)``, likewise."""
        return softmax(self.slope * scores + self.offsets, -1)


def calibrated(scores: np.ndarray, true: np.ndarray) -> Calibration:
    """The likeliest calibration.

    Args:
        scores: of examples, by a readout that was not taught by them, ``(n, m)``.
        true: places among classes, ``(n, m)``, one 1 a row.

    Example:
        >>> said = np.array([[0.4, 0.6], [0.6, 0.4], [0.4, 0.6], [0.4, 0.6]])
        >>> true = np.array([[0, 1.0], [1, 0], [0, 1], [1, 0]])
        >>> calibrated(said, true)(said)[0].round(2).tolist()
        [0.33, 0.67]
    """
    spread = max(float(scores.std()), 1e-12)
    unit = (scores - scores.mean()) / spread

    def loss(at: np.ndarray) -> tuple[float, np.ndarray]:
        logarithm = log_softmax(at[0] * unit + at[1:], -1)
        wrong = (np.exp(logarithm) - true) / len(true)
        value = -(true * logarithm).sum() / len(true) + PRIOR * (at[1:] ** 2).sum()
        return value, np.r_[(wrong * unit).sum(), wrong.sum(0) + 2 * PRIOR * at[1:]]

    bounds = [(0.0, STEEPEST)] + [(None, None)] * true.shape[1]
    start = np.r_[1.0, np.zeros(true.shape[1])]
    slope, *offsets = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x
    return Calibration(slope / spread, np.array(offsets) - slope * scores.mean() / spread)


def calibration_error(probabilities: np.ndarray, true: np.ndarray) -> float:
    """How far confidence is from the share that is right, weighted over bins of it.

    Args:
        probabilities: ``(e, m)``.
        true: number of the class, ``(e,)``.

    Example:
        >>> calibration_error(np.array([[0.75, 0.25]] * 4), np.array([0, 0, 1, 1]))
        0.25
    """
    sure, right = probabilities.max(-1), probabilities.argmax(-1) == true
    bins = np.minimum((sure * BINS).astype(int), BINS - 1)
    gaps = [abs(sure[bins == b].mean() - right[bins == b].mean()) for b in np.unique(bins)]
    return float(np.average(gaps, weights=np.unique(bins, return_counts=True)[1]))
