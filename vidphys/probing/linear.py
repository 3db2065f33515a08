"""Linear readouts of any number of targets from one decomposition, each clip predicted unseen.

A ridge regression on as many features as a map has needs no more than the examples' inner products.
One eigendecomposition of these a fold gives every strength of the ridge, every target and every
control of the labels. The strength is the one whose predictions of clips left out, each in turn,
are best; leaving a clip out has a closed form (Allen's PRESS, in blocks), so nothing is fitted
again. Angles are read as unit vectors; classes as scores, which a logistic regression on what was
said of the clips left out makes probabilities.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from vidphys.probing.confidence import calibrated
from vidphys.probing.folds import CrossValidation, Predictions, Taught
from vidphys.probing.forms import standardised

STRENGTHS = np.logspace(-5, 2, 15)  # of the ridge, relative to the mean eigenvalue
COLUMNS_AT_ONCE = 8192
SMALLEST = 1e-3  # of the mean square: below it a residual's logarithm says nothing
SILENT = 1e-10  # of the largest variance: what varies less is rounding


@dataclass(frozen=True)
class Seen:
    """Examples as a ridge regression sees them: by their features, or by their inner products.

    Args:
        rows: features ``(e, d)`` where they are few, else inner products ``(e, e)``; float64.
        features: which of the two.
    """

    rows: np.ndarray
    features: bool

    def centred(self, train: np.ndarray, test: np.ndarray) -> Centred:
        """The training examples about their mean, decomposed."""
        if self.features:
            return _of_features(self.rows[train], self.rows[test])
        return _of_products(self.rows[np.ix_(train, train)], self.rows[np.ix_(test, train)])


@dataclass(frozen=True)
class Centred:
    """``X = U sqrt(S) V'`` of training examples about their mean.

    Args:
        values: S, ``(r,)``.
        vectors: U, ``(n, r)``.
        across: of the examples tested, ``(s, r)``: their products with X, times U.
    """

    values: np.ndarray
    vectors: np.ndarray
    across: np.ndarray


def seen_as(values: Tensor) -> Seen:
    """The maps ``(e, c, h, w)`` of examples.

    Channels are brought to one spread first, whatever the labels are, so that loud ones do not
    rule.
    """
    flat = standardised(values).flatten(1) / values[0].numel() ** 0.5
    if flat.shape[1] <= len(flat) // 2:
        return Seen(flat.double().numpy(), True)
    products = torch.zeros(len(flat), len(flat), dtype=torch.float64)
    for some in flat.split(COLUMNS_AT_ONCE, 1):
        products += (some @ some.T).double()
    return Seen(products.numpy(), False)


def _of_products(inside: np.ndarray, across: np.ndarray) -> Centred:
    middle = inside.mean(0)
    centred = inside - middle - middle[:, None] + middle.mean()
    across = across - across.mean(1, keepdims=True) - middle + middle.mean()
    values, vectors = (found.numpy() for found in torch.linalg.eigh(torch.from_numpy(centred)))
    return Centred(values.clip(0), vectors, across @ vectors)


def _of_features(inside: np.ndarray, across: np.ndarray) -> Centred:
    middle = inside.mean(0)
    inside, across = inside - middle, across - middle
    values, axes = (
        found.numpy() for found in torch.linalg.eigh(torch.from_numpy(inside.T @ inside))
    )
    kept = values > SILENT * max(values[-1], 1e-300)
    root, axes = np.sqrt(values[kept]), axes[:, kept]
    return Centred(values[kept], inside @ axes / root, across @ axes * root)


@dataclass(frozen=True)
class Fitted:
    """What one fold's readout says.

    Args:
        said: of the examples tested, ``(s, m)``.
        left_out: residuals of the examples trained on, each by the readout without its clip,
            ``(n, m)``.
        strength: of the ridge, relative.
        error: the sum of the residuals' squares.
    """

    said: np.ndarray
    left_out: np.ndarray
    strength: float
    error: float


class Basis:
    """The training examples of a fold, decomposed once for all targets.

    Args:
        seen: all examples.
        train, test: numbers of examples.
        clips: of every example, ``(e,)``.
    """

    def __init__(self, seen: Seen, train: np.ndarray, test: np.ndarray, clips: np.ndarray) -> None:
        centred = seen.centred(train, test)
        self.values, self.vectors, self.across = centred.values, centred.vectors, centred.across
        self.strengths = STRENGTHS * max(self.values.sum() / len(train), 1e-300)
        self.blocks = list(self._blocks(clips[train]))

    def fit(self, targets: Sequence[np.ndarray]) -> list[Fitted]:
        """The readouts of targets ``(n, m)`` each, under one strength for all of its columns."""
        mean = [target.mean(0) for target in targets]
        centred = np.concatenate([t - m for t, m in zip(targets, mean, strict=True)], 1)
        rotated = self.vectors.T @ centred
        residuals = [self._residual(k, centred, rotated) for k in range(len(self.strengths))]
        errors = np.stack([(residual**2).sum(0) for residual in residuals])
        found, start = [], 0
        for middle in mean:
            own = slice(start, start := start + len(middle))
            number = int(errors[:, own].sum(1).argmin())
            weights = rotated[:, own] / (self.values + self.strengths[number])[:, None]
            said, left_out = middle + self.across @ weights, residuals[number][:, own]
            error = float(errors[number, own].sum())
            found.append(Fitted(said, left_out, float(STRENGTHS[number]), error))
        return found

    def _residual(self, number: int, centred: np.ndarray, rotated: np.ndarray) -> np.ndarray:
        """Of the examples trained on, as it would be had each clip been left out."""
        shrunk = (self.values / (self.values + self.strengths[number]))[:, None] * rotated
        plain = centred - self.vectors @ shrunk
        found = np.empty_like(plain)
        for index, inverses in self.blocks:
            found[index] = inverses[number] @ plain[index]
        return found

    def _blocks(self, clips: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """For clips of equally many examples: their numbers ``(g, q)``, and ``(I - H)^-1``.

        The latter under every strength, ``(strengths, g, q, q)``.
        """
        kept = self.values / (self.values + self.strengths[:, None])
        for index in _alike(clips):
            rows = self.vectors[index]
            hats = np.stack([(rows * each) @ rows.transpose(0, 2, 1) for each in kept])
            hats += 1 / len(clips)
            yield index, _inverses(np.eye(index.shape[1]) - hats)


def _inverses(matrices: np.ndarray) -> np.ndarray:
    """Of symmetric matrices, without the directions in which they vanish."""
    values, vectors = np.linalg.eigh(matrices)
    large = values > 1e-15 * np.abs(values).max(-1, keepdims=True)
    values = np.divide(1.0, values, out=np.zeros_like(values), where=large)
    return (vectors * values[..., None, :]) @ np.swapaxes(vectors, -1, -2)


def _alike(clips: np.ndarray) -> Iterator[np.ndarray]:
    """Numbers of the examples of clips with equally many, ``(g, q)`` each."""
    order = np.argsort(clips, kind="stable")
    each = np.split(order, np.nonzero(np.diff(clips[order]))[0] + 1)
    for size in sorted({len(index) for index in each}):
        yield np.stack([index for index in each if len(index) == size])


class Bases:
    """Forms of the features in one fold, decomposed once for all targets that know alike.

    Args:
        forms: the examples, by the name of the form.
        test: numbers of the examples that are tested.
        clips: of every example, ``(e,)``.
    """

    def __init__(self, forms: Mapping[str, Seen], test: np.ndarray, clips: np.ndarray) -> None:
        self.forms, self.test, self.clips = forms, test, clips
        self._made: dict[bytes, dict[str, Basis]] = {}

    def best(self, train: np.ndarray, values: Sequence[np.ndarray]) -> list[tuple[str, Fitted]]:
        """For each target the form whose predictions of clips left out are best, and its readout.

        Args:
            train: numbers of the examples that teach.
            values: theirs, of each target, ``(n, ...)``.
        """
        flat = [each.reshape(len(each), -1) for each in values]
        fitted = {name: basis.fit(flat) for name, basis in self._of(train).items()}
        names = [min(fitted, key=lambda name: fitted[name][k].error) for k in range(len(values))]
        return [(name, fitted[name][k]) for k, name in enumerate(names)]

    def answer(self, taught: Sequence[Taught]) -> None:
        """Fill in what the fold says of each target; those that know alike are fitted together."""
        for key in dict.fromkeys(each.train.tobytes() for each in taught):
            some = [each for each in taught if each.train.tobytes() == key]
            told = self.best(some[0].train, [each.values for each in some])
            for each, (form, fitted) in zip(some, told, strict=True):
                each.said.forms[form] += 1
                each.said.raw[self.test] = _told(fitted, each.values, each.classes)
            self._controls(some, told)

    def _controls(self, some: Sequence[Taught], told: Sequence[tuple[str, Fitted]]) -> None:
        others = [each.exchanged for each in some if each.exchanged is not None]
        if not others:
            return
        train = some[0].train
        for each, other, (_, fitted) in zip(some, others, self.best(train, others), strict=True):
            each.said.permuted[self.test] = _told(fitted, other, each.classes)
        for name, basis in self._of(train).items():
            mine = [k for k, each in enumerate(some) if told[k][0] == name and not each.classes]
            doubts = _doubts(basis, [told[k][1].left_out for k in mine]) if mine else []
            for k, doubt in zip(mine, doubts, strict=True):
                some[k].said.doubt[self.test] = doubt.reshape(-1, *some[k].values.shape[1:])

    def _of(self, train: np.ndarray) -> dict[str, Basis]:
        key = train.tobytes()
        if key not in self._made:
            self._made[key] = {
                name: Basis(seen, train, self.test, self.clips) for name, seen in self.forms.items()
            }
        return self._made[key]


def read_linearly(forms: Mapping[str, Seen], asked: CrossValidation) -> list[Predictions]:
    """Predictions of each target, each in the form of the features that does best for it.

    Args:
        forms: the examples, by the name of the form.
        asked: see there.

    Raises:
        ValueError: a fold leaves fewer than two clips to train on.
    """
    for fold in asked.each_fold():
        Bases(forms, fold.test, asked.groups).answer(fold.taught)
    return asked.found


def _told(fitted: Fitted, values: np.ndarray, classes: bool) -> np.ndarray:
    """In the shape of the values ``(n, k, m)``; scores of classes as probabilities."""
    said = fitted.said.reshape(-1, *values.shape[1:])
    if classes:
        heard = values - fitted.left_out.reshape(values.shape)
        for k in range(values.shape[1]):
            said[:, k] = calibrated(heard[:, k], values[:, k])(said[:, k])
    return said


def _doubts(basis: Basis, residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The expected errors, ``(s, m)``: the logarithm of the squared residuals, read likewise."""
    usual = [(each**2).mean(0).clip(1e-300) for each in residuals]
    square = [each**2 / u for each, u in zip(residuals, usual, strict=True)]
    logarithms = [np.log(np.maximum(each, SMALLEST)) for each in square]
    found = []
    for u, s, log, read in zip(usual, square, logarithms, basis.fit(logarithms), strict=True):
        scale = (s / np.exp(log - read.left_out)).mean(0)  # as large as the residuals are
        found.append(np.sqrt(u * scale * np.exp(read.said)))
    return found
