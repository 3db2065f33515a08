"""How good a prediction is, for any kind of target on one scale, with intervals by clip.

Every score is 1 for perfect and about 0 for what knows nothing: one minus the errors over the
errors of chance. Of numbers that is R^2, against the mean of what was trained on; of angles one
minus the mean angle between over 90 degrees; of classes the balanced accuracy above chance. Each
clip adds to both sums, so that clips can be drawn anew: frames of one clip are not independent, nor
are clips that stay together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.probing.coding import decoded
from vidphys.probing.targets import Labels

DRAWS = 1000
LEVEL = 95.0  # per cent


@dataclass(frozen=True)
class Sums:
    """Errors, and those of chance, summed in each group of clips, ``(groups,)`` each."""

    error: np.ndarray
    chance: np.ndarray

    @property
    def score(self) -> float:
        """Of all clips."""
        return float(1 - self.error.sum() / self.chance.sum())


@dataclass(frozen=True)
class Score:
    """A score, or a difference of two, and its interval (95 %, by clip)."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.2f} [{self.low:.2f}, {self.high:.2f}]"


def sums_of(
    labels: Labels, raw: np.ndarray, constant: np.ndarray, clips: np.ndarray, groups: np.ndarray
) -> Sums:
    """Errors of predictions.

    Args:
        labels: what is true; examples of which it is not known do not count.
        raw: what was predicted, ``(e, k, m)``, see :mod:`vidphys.probing.coding`.
        constant: what is predicted without looking, likewise.
        clips: number of each example's clip, from 0, ``(e,)``.
        groups: number of each clip's group, from 0, ``(clips,)``.

    Example:
        >>> truth = Labels("x", "regression", "frame", np.array([[0.0], [1.0], [2.0]]))
        >>> said, mean = np.array([[[0.0]], [[1.0]], [[1.0]]]), np.ones((3, 1, 1))
        >>> sums_of(truth, said, mean, np.arange(3), np.arange(3)).score
        0.5
    """
    count, known = int(groups.max()) + 1, labels.known
    if labels.per == "clip":
        labels, raw, constant, clips = _averaged(labels, raw, constant, clips)
        known = labels.known
    true = labels.values[known]
    said = decoded(labels, raw[known], constant[known])
    error, chance = _errors(labels, true, said, constant[known])
    each = [np.bincount(groups[clips[known]], part.sum(1), count) for part in (error, chance)]
    return Sums(*each)


def _errors(
    labels: Labels, true: np.ndarray, said: np.ndarray, constant: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of each example and column, and of chance, ``(e, k)``."""
    if labels.kind == "circular":
        turn = np.abs(np.angle(np.exp(1j * (said - true))))
        return turn / (np.pi / 2), np.ones_like(turn)
    if labels.kind == "classification":
        share = _shares(true, len(labels.classes))
        present = max(2, len(np.unique(true)))
        return share * (said != true) / (1 - 1 / present), share
    scale = true.std(0).clip(1e-12)
    return ((said - true) / scale) ** 2, ((constant[..., 0] - true) / scale) ** 2


def _shares(true: np.ndarray, classes: int) -> np.ndarray:
    """Weights under which every class of a column counts alike."""
    weights = np.empty_like(true)
    for k in range(true.shape[1]):
        sizes = np.bincount(true[:, k].astype(int), minlength=classes)
        weights[:, k] = 1 / sizes[true[:, k].astype(int)]
    return weights


def _averaged(
    labels: Labels, raw: np.ndarray, constant: np.ndarray, clips: np.ndarray
) -> tuple[Labels, np.ndarray, np.ndarray, np.ndarray]:
    """One example for each clip: its value, and the mean of what its frames say."""
    numbers, first = np.unique(clips, return_index=True)
    said, mean = (
        np.stack([part[clips == number].mean(0) for number in numbers]) for part in (raw, constant)
    )
    one = Labels(labels.name, labels.kind, labels.per, labels.values[first], labels.classes)
    return one, said, mean, numbers


class Bootstrap:
    """Clips drawn anew, the same draws for all that is compared.

    Args:
        clips: how many there are.
        seed: of the draws.
    """

    def __init__(self, clips: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.times = rng.multinomial(clips, np.full(clips, 1 / clips), DRAWS).astype(float)

    def draws(self, sums: Sums) -> np.ndarray:
        """The score under each draw, ``(draws,)``."""
        return 1 - (self.times @ sums.error) / np.maximum(self.times @ sums.chance, 1e-300)

    def score(self, sums: Sums) -> Score:
        """With the interval between percentiles of the draws."""
        return _between(sums.score, self.draws(sums))

    def difference(self, first: Sums, second: Sums) -> Score:
        """Of two scores on the same clips."""
        draws = self.draws(first) - self.draws(second)
        return _between(first.score - second.score, draws)


def _between(value: float, draws: np.ndarray) -> Score:
    low, high = np.percentile(draws, [(100 - LEVEL) / 2, (100 + LEVEL) / 2])
    return Score(value, float(low), float(high))


def in_words(labels: Labels, score: float) -> str:
    """A score in the unit that people know.

    Example:
        >>> in_words(Labels("way", "circular", "frame", np.zeros((1, 1))), 0.5)
        '45 degrees off'
    """
    if labels.kind == "circular":
        return f"{90 * (1 - score):.0f} degrees off"
    if labels.kind == "classification":
        classes = max(2, len(labels.classes))
        return f"{100 * (score * (1 - 1 / classes) + 1 / classes):.0f} % right"
    return f"R^2 {score:.2f}"
