"""From feature frames to what a layer knows of a target, beside all controls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from vidphys.probing.coding import coded, decoded
from vidphys.probing.confidence import calibration_error
from vidphys.probing.controls import CONSTANT, CONTROLS, PERMUTED
from vidphys.probing.folds import CrossValidation, Predictions, Question, fold_of
from vidphys.probing.keeping import KEPT
from vidphys.probing.readouts import Readout
from vidphys.probing.scores import Bootstrap, Score, Sums, sums_of
from vidphys.probing.targets import Labels
from vidphys.statistics import spearman


@dataclass(frozen=True)
class Finding:
    """What one layer knows of one target.

    Args:
        layer, depth: its name, and its place among all layers: 0 the first, 1 the last.
        target: what was asked.
        score: on clips that the readout did not see; see :mod:`vidphys.probing.scores`.
        controls: likewise, by name; those that could not be had are not there.
        best: the best of the rivals among them.
        selectivity: the score less that of ``best``.
        calibration: of a regression, rank correlation between the error that the readout expects
            and its error; ``None`` of others.
        miscalibration: of a classification, how far confidence is from the share that is right;
            ``None`` of others.
        forms: of the features, and in how many folds the readout took each.
        sums: of the score, for further comparisons.
        kept: by the cheaper way to keep the features, what the score gains by it (mostly less
            than zero), and the bytes an example takes; see :mod:`vidphys.probing.keeping`.
    """

    layer: str
    depth: float
    target: Labels
    score: Score
    controls: Mapping[str, Score]
    best: str
    selectivity: Score
    calibration: float | None
    miscalibration: float | None
    forms: Mapping[str, int]
    sums: Sums
    kept: Mapping[str, tuple[Score, int]]

    @property
    def form(self) -> str:
        """The form of the features that most folds took."""
        return max(self.forms, key=lambda name: self.forms[name])


@dataclass(frozen=True)
class Asked:
    """What is read, of which examples, and how.

    Args:
        targets: with values for each example.
        clips: number of each example's clip, from 0, ``(e,)``; a clip's are in order of time.
        groups: number of each clip's group, from 0, ``(clips,)``; those of a group are tested, left
            out and drawn anew together.
        seed: of the folds and all draws.
        folds: in which all clips are tested.
        readout: of maps; see :data:`READOUTS`.
        kept: of :data:`KEPT`, whose cost is measured.
    """

    targets: Sequence[Labels]
    clips: np.ndarray
    groups: np.ndarray
    seed: int
    folds: int
    readout: Readout
    kept: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        """Groups of clips."""
        return int(self.groups.max()) + 1

    def read(self, maps: Tensor, controls: bool = False) -> list[Predictions]:
        """What a readout of these maps says of each target."""
        asked = CrossValidation(
            [Question(coded(t), t.known, t.kind == "classification") for t in self.targets],
            self.groups[self.clips],
            fold_of(self.count, min(self.folds, self.count), self.seed),
            self.seed,
            controls,
        )
        return self.readout(maps, asked)

    def sums(self, said: Sequence[Predictions], what: str = "raw") -> list[Sums]:
        """Errors of each target's predictions."""
        found = []
        for labels, each in zip(self.targets, said, strict=True):
            raw, constant = getattr(each, what), each.constant
            found.append(sums_of(labels, raw, constant, self.clips, self.groups))
        return found


def findings_of(
    layer: str,
    depth: float,
    maps: Tensor,
    others: Mapping[str, Tensor],
    given: Mapping[str, Sequence[Sums]],
    asked: Asked,
) -> list[Finding]:
    """What a layer knows of every target.

    Args:
        layer, depth: see :class:`Finding`.
        maps: of the examples, ``(e, c, h, w)``.
        others: by control, the maps that it reads instead.
        given: by control, what is known of it already (that of the pixels is the same for all).
        asked: what is read.
    """
    said = asked.read(maps, controls=True)
    own = asked.sums(said)
    controls = {
        name: own if other is maps else asked.sums(asked.read(other))
        for name, other in others.items()
    }
    cheaper = {name: asked.sums(asked.read(KEPT[name].keep(maps))) for name in asked.kept}
    shape = maps.shape[1], maps.shape[2], maps.shape[3]
    controls |= {name: list(sums) for name, sums in given.items()}
    controls |= {name: asked.sums(said, name) for name in (PERMUTED, CONSTANT)}
    draws, found = Bootstrap(asked.count, asked.seed), []
    for k, labels in enumerate(asked.targets):
        each = {name: controls[name][k] for name in CONTROLS if name in controls}
        best = max((name for name in each if CONTROLS[name].rival), key=lambda n: each[n].score)
        found.append(
            Finding(
                layer,
                depth,
                labels,
                draws.score(own[k]),
                {name: draws.score(sums) for name, sums in each.items()},
                best,
                draws.difference(own[k], each[best]),
                _calibration(labels, said[k]),
                _miscalibration(labels, said[k]),
                said[k].forms,
                own[k],
                {
                    name: (draws.difference(sums[k], own[k]), KEPT[name].bytes(*shape))
                    for name, sums in cheaper.items()
                },
            )
        )
    return found


def _calibration(labels: Labels, said: Predictions) -> float | None:
    if labels.kind != "regression":
        return None
    known = labels.known
    error = np.abs(decoded(labels, said.raw, said.constant) - labels.values)
    doubt = said.doubt[known].ravel()
    if np.ptp(doubt) == 0 or np.ptp(error[known]) == 0:
        return None
    return spearman(doubt.tolist(), error[known].ravel().tolist())


def _miscalibration(labels: Labels, said: Predictions) -> float | None:
    if labels.kind != "classification":
        return None
    raw, true = said.raw[labels.known], labels.values[labels.known]
    return calibration_error(raw.reshape(-1, raw.shape[-1]), true.ravel())
