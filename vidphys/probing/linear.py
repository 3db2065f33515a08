"""Linear readouts of any number of targets from one decomposition, each clip predicted unseen.

A ridge regression on as many features as a map has needs no more than the examples' inner products.
One eigendecomposition of these a fold gives every strength of the ridge, every target and every
control of the labels. The strength is the one whose predictions of clips left out, each in turn,
are best; leaving a clip out has a closed form (Allen's PRESS, in blocks), so nothing is fitted
again. Classes are read as numbers between which the largest decides, angles as unit vectors.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from vidphys.seeding import derive

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
    flat = _scaled(values) / values[0].numel() ** 0.5
    if flat.shape[1] <= len(flat) // 2:
        return Seen(flat.double().numpy(), True)
    products = torch.zeros(len(flat), len(flat), dtype=torch.float64)
    for some in flat.split(COLUMNS_AT_ONCE, 1):
        products += (some @ some.T).double()
    return Seen(products.numpy(), False)


def _scaled(values: Tensor) -> Tensor:
    channels = values.float()
    deviation = channels.std((0, 2, 3), keepdim=True)
    floor = (0.1 * deviation.median()).clamp_min(
        1e-12
    )  # one that hardly ever speaks is not magnified to noise
    middle = channels.mean((0, 2, 3), keepdim=True)
    return ((channels - middle) / torch.maximum(deviation, floor)).flatten(1)


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


def fold_of(clips: int, folds: int, seed: int) -> np.ndarray:
    """Which fold tests each clip, ``(clips,)``; every clip is tested once."""
    order = np.random.default_rng(derive(seed, "folds")).permutation(clips)
    found = np.empty(clips, int)
    found[order] = np.arange(clips) % folds
    return found


@dataclass(frozen=True)
class Fitted:
    """What one fold's readout says.

    Args:
        said: of the examples tested, ``(s, m)``.
        left_out: residuals of the examples trained on, each by the readout without its clip,
            ``(n, m)``.
        strength: of the ridge, relative.
    """

    said: np.ndarray
    left_out: np.ndarray
    strength: float


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
        self.blocks = [self._blocks(strength, clips[train]) for strength in self.strengths]

    def fit(self, targets: np.ndarray) -> Fitted:
        """The readout of some columns ``(n, m)`` under one strength for all of them."""
        mean = targets.mean(0)
        rotated = self.vectors.T @ (targets - mean)
        best: tuple[float, int, np.ndarray] | None = None
        for number, strength in enumerate(self.strengths):
            shrunk = (self.values / (self.values + strength))[:, None] * rotated
            residual = self._without_own(number, targets - mean - self.vectors @ shrunk)
            error = float((residual**2).sum())
            if best is None or error < best[0]:
                best = error, number, residual
        assert best is not None
        _, number, residual = best
        weights = rotated / (self.values + self.strengths[number])[:, None]
        return Fitted(mean + self.across @ weights, residual, float(STRENGTHS[number]))

    def _blocks(self, strength: float, clips: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """For clips of equally many examples: their numbers ``(g, q)``, and ``(I - H)^-1``."""
        weight = np.sqrt(self.values / (self.values + strength))
        shrunk, count = self.vectors * weight, len(clips)
        found = []
        for index in _alike(clips):
            rows = shrunk[index]
            hat = rows @ rows.transpose(0, 2, 1) + 1 / count
            found.append((index, np.linalg.pinv(np.eye(index.shape[1]) - hat, hermitian=True)))
        return found

    def _without_own(self, number: int, residual: np.ndarray) -> np.ndarray:
        """Residuals as they would be, had each clip been left out."""
        found = np.empty_like(residual)
        for index, inverse in self.blocks[number]:
            found[index] = inverse @ residual[index]
        return found


def _alike(clips: np.ndarray) -> Iterator[np.ndarray]:
    """Numbers of the examples of clips with equally many, ``(g, q)`` each."""
    order = np.argsort(clips, kind="stable")
    each = np.split(order, np.nonzero(np.diff(clips[order]))[0] + 1)
    for size in sorted({len(index) for index in each}):
        yield np.stack([index for index in each if len(index) == size])


@dataclass(frozen=True)
class Predictions:
    """What a readout says of every example, each by a fold that did not see its clip.

    Args:
        raw: ``(e, m)``.
        constant: what is said without looking: the mean of what was trained on.
        permuted: likewise, by a readout whose labels were exchanged between clips.
        doubt: the error that is expected of each column, its unit, ``(e, m)``; learned from how
            wrong the predictions of clips left out were.
    """

    raw: np.ndarray
    constant: np.ndarray
    permuted: np.ndarray
    doubt: np.ndarray

    def shaped(self, shape: tuple[int, ...]) -> Predictions:
        """All four in another shape."""
        return Predictions(*(getattr(self, each.name).reshape(shape) for each in fields(self)))

    @classmethod
    def like(cls, target: np.ndarray) -> Predictions:
        """Of as many examples and columns, not filled in yet."""
        return cls(*(np.zeros_like(target) for _ in range(4)))


def read_linearly(
    seen: Seen,
    targets: Sequence[np.ndarray],
    known: Sequence[np.ndarray],
    clips: np.ndarray,
    folds: np.ndarray,
    seed: int = 0,
    controls: bool = True,
) -> list[Predictions]:
    """Predictions of each target.

    Args:
        seen: the examples.
        targets: ``(e, m)`` each.
        known: whether an example may be trained on, ``(e,)`` each.
        clips: of every example, ``(e,)``.
        folds: which tests each clip, ``(clips,)``.
        seed: of the exchange of labels.
        controls: whether ``permuted`` and ``doubt`` are asked for; they stay zero otherwise.

    Raises:
        ValueError: a fold leaves fewer than two clips to train on.
    """
    found = [Predictions.like(each) for each in targets]
    tested_by = folds[clips]
    bases: dict[tuple[int, bytes], Basis] = {}
    for fold in np.unique(folds):
        test = np.nonzero(tested_by == fold)[0]
        for target, mask, said in zip(targets, known, found, strict=True):
            train = np.nonzero((tested_by != fold) & mask)[0]
            if len(np.unique(clips[train])) < 2:
                raise ValueError(
                    f"probe: fold {fold} leaves {len(np.unique(clips[train]))} clips to train on; "
                    "give more clips, or a target that is known in more of them"
                )
            key = int(fold), train.tobytes()
            if key not in bases:
                bases = {k: basis for k, basis in bases.items() if k[0] == fold}
                bases[key] = Basis(seen, train, test, clips)
            fitted = bases[key].fit(target[train])
            said.raw[test], said.constant[test] = fitted.said, target[train].mean(0)
            if controls:
                other = exchanged(target[train], clips[train], seed)
                said.permuted[test] = bases[key].fit(other).said
                said.doubt[test] = _doubt(bases[key], fitted.left_out)
    return found


def _doubt(basis: Basis, residual: np.ndarray) -> np.ndarray:
    """The expected error, ``(s, m)``: the logarithm of the squared residuals, read likewise."""
    square = residual**2
    usual = square.mean(0).clip(1e-300)
    read = basis.fit(np.log(np.maximum(square / usual, SMALLEST)))
    logarithm = np.log(np.maximum(square / usual, SMALLEST)) - read.left_out
    scale = (square / usual / np.exp(logarithm)).mean(0)  # as large as the residuals are
    return np.sqrt(usual * scale * np.exp(read.said))


def exchanged(values: np.ndarray, clips: np.ndarray, seed: int) -> np.ndarray:
    """The values of other clips: those of a clip stay together and in their order."""
    numbers = np.unique(clips)
    order = np.random.default_rng(derive(seed, "permuted")).permutation(numbers)
    found = np.empty_like(values)
    for own, other in zip(numbers, order, strict=True):
        mine, theirs = np.nonzero(clips == own)[0], np.nonzero(clips == other)[0]
        found[mine] = values[theirs[np.arange(len(mine)) % len(theirs)]]
    return found
