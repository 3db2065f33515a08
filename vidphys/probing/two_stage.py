"""A readout in two stages: the bodies' positions from the map, then motion from their track.

Whatever it says, it says of positions alone: an encoder that a linear readout beats knows more than
where bodies are. What the second stage learns from are positions of clips that the first was not
taught by, so that it knows how wrong they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import torch
from torch import Tensor

from vidphys.probing.folds import CrossValidation, Predictions, Question
from vidphys.probing.linear import Bases, seen_as
from vidphys.probing.readouts import TWO_STAGE, Readout, seen_forms
from vidphys.probing.truth import Track

LEAST = 3  # frames of a clip from which differences in time are taken


@dataclass(frozen=True)
class TwoStage(Readout):
    """See the module.

    Args:
        track: the true one, which teaches the first stage.

    Raises:
        ValueError: a body's place is not known in some example.
    """

    track: Track

    def __post_init__(self) -> None:
        if not np.isfinite(self.track.positions).all():
            raise ValueError(
                "probe: `readout` two-stage: it is taught by the place of every body in every "
                "frame that is read; a table lacks some"
            )

    def __call__(self, maps: Tensor, asked: CrossValidation) -> list[Predictions]:
        places = self.track.positions.reshape(len(maps), -1)
        where = Question(places[..., None], np.ones(len(maps), bool))
        first = replace(asked, questions=[where], controls=False)
        forms = seen_forms(maps)
        for fold, seen in zip(asked.each_fold(), first.each_fold(), strict=True):
            (taught,) = seen.taught
            bases = Bases(forms, seen.test, asked.groups)
            ((_, fitted),) = bases.best(taught.train, [taught.values])
            read = np.empty_like(places)
            read[seen.test], read[taught.train] = (
                fitted.said,
                places[taught.train] - fitted.left_out,
            )
            moving = self._motion(read.reshape(self.track.positions.shape))
            Bases({TWO_STAGE: seen_as(moving)}, fold.test, asked.groups).answer(fold.taught)
        return asked.found

    def _motion(self, positions: np.ndarray) -> Tensor:
        """What a track tells of every example, ``(e, c, 1, 1)``."""
        clips = self.track.clips
        told = [
            motion_of(positions[clips == clip], self.track.times[clips == clip])
            for clip in np.unique(clips)
        ]
        return torch.from_numpy(np.concatenate(told))[..., None, None]


def motion_of(positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Positions, velocities, accelerations, speeds, directions and distances, ``(t, c)``.

    Args:
        positions: of one clip, ``(t, n, 2)``.
        times: seconds, ``(t,)``.

    Example:
        >>> track = np.array([[[0.0, 0.0]], [[2.0, 0.0]], [[4.0, 0.0]]])
        >>> motion_of(track, np.array([0.0, 1.0, 2.0]))[1].tolist()
        [2.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 1.0, 0.0]
    """
    velocity = np.gradient(positions, times, axis=0)
    speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
    parts = [positions, velocity, np.gradient(velocity, times, axis=0), speed]
    parts.append(velocity / np.maximum(speed, 1e-12))
    pairs = combinations(range(positions.shape[1]), 2)
    apart = [np.linalg.norm(positions[:, i] - positions[:, j], axis=-1) for i, j in pairs]
    return np.concatenate(
        [p.reshape(len(times), -1) for p in parts] + [a[:, None] for a in apart], 1
    )
