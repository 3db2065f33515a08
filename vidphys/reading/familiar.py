"""Is a clip like those that a training learned from? Three numbers, each with its error rate.

*features*: how far the strangest cell of a picture is from all that were seen
(:mod:`vidphys.reading.memory`). *doubt*: how large the readout expects its own errors to be, which
it was taught from those it makes and from the spread of its readers. *physics*: how far the next
frames are from those that the law foretells.

The limit of each is from stretches of clips that were only scored, so that a stretch of another
such clip lies beyond it as seldom as is said (conformal prediction; Vovk, Gammerman and Shafer,
"Algorithmic learning in a random world", 2005).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import Tensor

from binders.tracks import Tracks
from readouts.attention import distance_at
from vidphys.data.splits import Split
from vidphys.reading.clip_dynamics import FACTORED, Dynamics, Followed
from vidphys.reading.memory import FeatureMemory
from vidphys.reading.seen_clips import few
from vidphys.shooting.foretold import missed

FEATURES, DOUBT, PHYSICS = "features", "doubt", "physics"
SAID = {
    FEATURES: "what the encoder sees lies {} times as far from what it saw in training",
    DOUBT: "the readout expects errors {} times as large",
    PHYSICS: "the law is {} times as far from the frames that it foretells",
}
RATE = 0.05  # of stretches that may lie beyond a limit
AHEAD, CONTEXT, LEAST = 4, 7, 3  # samples of a stretch; before it at most, and at least
Scores = dict[str, Tensor]


@dataclass(frozen=True)
class Limit:
    """What few stretches of a scored clip exceed.

    Args:
        value: of the number; features: their standard deviations; doubt:
            normalised image units; physics: the dynamics' coordinates.
        rate: share of stretches of such clips that exceed it, at most.
    """

    value: float
    rate: float

    @classmethod
    def of(cls, values: Tensor) -> Self:
        """The least that leaves :data:`RATE` beyond it; the largest, where they are too few."""
        rank = min(math.ceil((len(values) + 1) * (1 - RATE)), len(values))
        return cls(float(values.sort().values[rank - 1]), 1 - rank / (len(values) + 1))


@dataclass(frozen=True)
class Flag:
    """One of the three numbers of a clip, the median over its stretches.

    Args:
        name: of the number.
        value: see :class:`Limit`.
        limit: that it is held against.
    """

    name: str
    value: float
    limit: Limit

    @property
    def raised(self) -> bool:
        """Whether half of the clip is beyond the limit."""
        return self.value > self.limit.value

    def __str__(self) -> str:
        times = f"{self.value / max(self.limit.value, 1e-12):.3g}"
        return (
            f"{SAID[self.name].format(times)} as its limit, beyond which lie "
            f"{self.limit.rate:.2g} of the stretches of clips like the training's"
        )


@dataclass(frozen=True)
class Familiar:
    """What new clips are held against.

    Args:
        memory: of the training's features.
        limits: by the name of the number; one that no scored clip was long enough for is absent.
    """

    memory: FeatureMemory
    limits: Mapping[str, Limit]

    def flags(self, strangeness: Tensor, followed: Followed, dynamics: Dynamics) -> list[Flag]:
        """The numbers of a clip that have a limit and that the clip is long enough for.

        Args:
            strangeness: of each feature frame, by the memory.
            followed: its tracks.
            dynamics: of the training.
        """
        scores = stretches(strangeness, followed, dynamics)
        return [
            Flag(name, float(scores[name].median()), limit)
            for name, limit in self.limits.items()
            if len(scores[name])
        ]

    def to_config(self) -> dict[str, Any]:
        """The limits as plain data; the memory's tensors are kept beside it."""
        return {name: [limit.value, limit.rate] for name, limit in self.limits.items()}


def familiar_of(
    maps: Sequence[Tensor], split: Split, followed: Sequence[Followed], dynamics: Dynamics
) -> Familiar:
    """From what a training was trained on, and what it was only scored on.

    Args:
        maps: features of each clip, ``(f, c, h, w)``.
        split: of the clips.
        followed: each clip's track.
        dynamics: of the training.
    """
    known = zip(maps, split.train, strict=True)
    memory = FeatureMemory.of(values[some] for values, frames in known for some in few(frames))
    found = []
    for values, scored, clip in zip(maps, split.scored, followed, strict=True):
        if len(scored):
            strange = torch.cat([memory.distance(values[some]) for some in few(scored)])
            found.append(stretches(strange, clip, dynamics, int(scored[0]) * split.each))
    return Familiar(memory, limits_of(found))


def limits_of(found: Sequence[Scores]) -> dict[str, Limit]:
    """Of the stretches of several clips."""
    every = {name: torch.cat([scores[name] for scores in found]) for name in SAID}
    return {name: Limit.of(values) for name, values in every.items() if len(values)}


def stretches(
    strangeness: Tensor, followed: Followed, dynamics: Dynamics, first: int = 0
) -> Scores:
    """Each number of each stretch of a clip; none where it is not finite.

    Args:
        strangeness: of each feature frame from that of frame ``first`` on.
        followed: the whole clip's track.
        dynamics: of the training.
        first: frame from which on the clip is looked at.
    """
    track = followed.track
    frame = float(track.times.diff().median()) if len(track.times) > 1 else dynamics.interval
    every = max(1, round(dynamics.interval / frame))
    doubt = distance_at(track.confidence[0, first:]).mean(-1)
    span = AHEAD * every
    pieces = len(doubt) / span  # of the clip; a feature frame may stand for several of its frames
    found = {
        FEATURES: _means(strangeness, max(1, round(len(strangeness) / max(pieces, 1)))),
        DOUBT: _means(doubt, span),
        PHYSICS: _physics(followed, dynamics, every, first),
    }
    return {name: values[values.isfinite()] for name, values in found.items()}


def _means(values: Tensor, span: int) -> Tensor:
    """Of stretches of so many values; of all, where they are fewer."""
    whole = len(values) // span * span
    return values[:whole].reshape(-1, span).mean(-1) if whole else values.mean(0, keepdim=True)


def _physics(followed: Followed, dynamics: Dynamics, every: int, first: int) -> Tensor:
    track = followed.until(len(followed.track.times)).track
    frames, span = len(track.times), AHEAD * every
    before = min(CONTEXT, (frames - 1) // every + 1 - AHEAD)
    reach = 1 + (before + AHEAD - 1) * every
    ends = range(frames, max(first + span, reach) - 1, -span)
    if before < LEAST or not ends:
        return torch.zeros(0)
    at = torch.stack([torch.arange(end - reach, end, every) for end in ends])
    places = dynamics.chart.coordinate(track.positions[0, at])
    seen = Tracks(places, track.confidence[0, at], track.times[at[0]])
    law = followed.law[[0] * len(at)]
    return missed(dynamics.heads[FACTORED], seen, law, dynamics.interval, AHEAD)
