"""How momenta come about where only positions are perceived: in training, and at t0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from dynamics import Head, PhaseState
from vidphys.experiments.pixels.seen import Perceived
from vidphys.shooting.initial_state import by_differencing, by_shooting, choose_slack
from vidphys.training.loop import FitResult
from vidphys.training.tracks import TrackTask, train_by_differencing, train_by_shooting


class MomentumReadout(Protocol):
    """One way from positions to momenta."""

    @property
    def name(self) -> str:
        """As in the records."""
        ...

    def train(self, head: Head, task: TrackTask) -> FitResult:
        """Train a head on tracks."""
        ...

    def start(self, head: Head, perceived: Perceived) -> PhaseState:
        """States at t0 of the held-out clips, ``(b, n, d)``, by a trained head."""
        ...


@dataclass(frozen=True)
class Differencing:
    """The study's: differences of frames, in training and at t0."""

    name: str = "differencing"

    def train(self, head: Head, task: TrackTask) -> FitResult:
        return train_by_differencing(head, task)

    def start(self, head: Head, perceived: Perceived) -> PhaseState:
        clips = perceived.seen.test
        return by_differencing(head, perceived.test, clips.params, clips.interval)


@dataclass(frozen=True)
class Shooting:
    """Through the head itself; the training clips say how far it is trusted."""

    name: str = "shooting"

    def train(self, head: Head, task: TrackTask) -> FitResult:
        return train_by_shooting(head, task)

    def start(self, head: Head, perceived: Perceived) -> PhaseState:
        train, test = perceived.seen.train, perceived.seen.test
        slack = choose_slack(head, perceived.train, train.params, test.interval)
        return by_shooting(head, perceived.under(head), test.params, test.interval, slack)


MOMENTUM: dict[str, MomentumReadout] = {way.name: way for way in (Differencing(), Shooting())}
