"""What a readout is asked, fold by fold: who teaches, who is tested, and where the answers go."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from vidphys.seeding import derive


@dataclass(frozen=True)
class Question:
    """One target in numbers.

    Args:
        values: ``(e, k, m)``, see :mod:`vidphys.probing.coding`.
        known: whether an example may teach, ``(e,)``.
        classes: whether the m numbers are places among classes.
    """

    values: np.ndarray
    known: np.ndarray
    classes: bool = False


@dataclass(frozen=True)
class Predictions:
    """What a readout says of every example, each by a fold that did not see its clip.

    Args:
        raw: ``(e, k, m)``; of classes, their probabilities.
        constant: what is said without looking: the mean of what taught.
        permuted: likewise, by a readout whose labels were exchanged between clips.
        doubt: the error that is expected of each number, its unit; of classes zero.
        forms: of the features, which it took and in how many folds.
    """

    raw: np.ndarray
    constant: np.ndarray
    permuted: np.ndarray
    doubt: np.ndarray
    forms: Counter[str] = field(default_factory=Counter)

    def shaped(self, shape: tuple[int, ...]) -> Predictions:
        """All four in another shape."""
        return Predictions(
            self.raw.reshape(shape),
            self.constant.reshape(shape),
            self.permuted.reshape(shape),
            self.doubt.reshape(shape),
            self.forms,
        )

    @classmethod
    def like(cls, values: np.ndarray) -> Predictions:
        """Of as many examples and numbers, not filled in yet."""
        raw, constant, permuted, doubt = (np.zeros(values.shape) for _ in range(4))
        return cls(raw, constant, permuted, doubt)


@dataclass(frozen=True)
class Taught:
    """One target in one fold.

    Args:
        train: numbers of the examples that teach.
        values: theirs, ``(n, k, m)``.
        exchanged: theirs, exchanged between clips; ``None`` where no controls are asked for.
        classes: see :class:`Question`.
        said: of all examples, to be filled in where the fold tests.
    """

    train: np.ndarray
    values: np.ndarray
    exchanged: np.ndarray | None
    classes: bool
    said: Predictions


@dataclass(frozen=True)
class Fold:
    """One fold.

    Args:
        test: numbers of the examples that it tests.
        taught: of each question.
    """

    test: np.ndarray
    taught: list[Taught]


@dataclass(frozen=True)
class CrossValidation:
    """Questions, answered of each group of clips by what did not see it.

    Args:
        questions: of the examples.
        groups: number of each example's group, ``(e,)``: its clip, or clips that stay together.
        folds: which tests each group, ``(groups,)``.
        seed: of the exchange of labels, and of whatever is trained.
        controls: whether ``permuted`` and ``doubt`` are asked for; they stay zero otherwise.
    """

    questions: Sequence[Question]
    groups: np.ndarray
    folds: np.ndarray
    seed: int = 0
    controls: bool = False

    @cached_property
    def found(self) -> list[Predictions]:
        """The answers, which are filled in fold by fold."""
        return [Predictions.like(each.values) for each in self.questions]

    def each_fold(self) -> Iterator[Fold]:
        """All folds; what is said without looking is filled in.

        Raises:
            ValueError: a fold leaves fewer than two groups to learn from.
        """
        tested_by = self.folds[self.groups]
        for fold in np.unique(self.folds):
            test, taught = np.nonzero(tested_by == fold)[0], []
            for question, said in zip(self.questions, self.found, strict=True):
                train = np.nonzero((tested_by != fold) & question.known)[0]
                if len(np.unique(self.groups[train])) < 2:
                    raise ValueError(
                        f"probe: fold {fold} leaves {len(np.unique(self.groups[train]))} clips to "
                        "train on; give more clips, or a target that is known in more of them"
                    )
                values = question.values[train]
                said.constant[test] = values.mean(0)
                other = exchanged(values, self.groups[train], self.seed) if self.controls else None
                taught.append(Taught(train, values, other, question.classes, said))
            yield Fold(test, taught)

    def only(self, numbers: Sequence[int]) -> CrossValidation:
        """Some of the questions."""
        return replace(self, questions=[self.questions[k] for k in numbers])

    def body_by_body(self, bodies: int) -> CrossValidation:
        """With each body as an example of its own; a question has as many columns for each."""
        questions = [
            Question(
                q.values.reshape(len(q.values) * bodies, -1, q.values.shape[-1]),
                q.known.repeat(bodies),
                q.classes,
            )
            for q in self.questions
        ]
        return replace(self, questions=questions, groups=self.groups.repeat(bodies))


def fold_of(groups: int, folds: int, seed: int) -> np.ndarray:
    """Which fold tests each group of clips, ``(groups,)``; every one is tested once."""
    order = np.random.default_rng(derive(seed, "folds")).permutation(groups)
    found = np.empty(groups, int)
    found[order] = np.arange(groups) % folds
    return found


def exchanged(values: np.ndarray, groups: np.ndarray, seed: int) -> np.ndarray:
    """The values of other groups: those of a group stay together and in their order."""
    numbers = np.unique(groups)
    order = np.random.default_rng(derive(seed, "permuted")).permutation(numbers)
    found = np.empty_like(values)
    for own, other in zip(numbers, order, strict=True):
        mine, theirs = np.nonzero(groups == own)[0], np.nonzero(groups == other)[0]
        found[mine] = values[theirs[np.arange(len(mine)) % len(theirs)]]
    return found
