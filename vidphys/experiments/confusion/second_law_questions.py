"""Which rate is learned in both worlds, and what clips that run backwards cost."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from torch import Tensor

from dynamics import Hamiltonian, Head, PhaseState
from readouts.differencing import central_difference
from vidphys.diagnose.weak.energy_balance import corrected_rate
from vidphys.experiments.confusion.questions import STUDY_RATE, recorder
from vidphys.experiments.confusion.rates import potential
from vidphys.experiments.confusion.scenes import attracted, drag, total
from vidphys.experiments.confusion.second_law import (
    AHEAD,
    EVERY,
    FREE,
    INTERVAL,
    POSITIVE,
    Film,
    film,
    rate_of,
    train_port,
    unit_law,
    windows,
)
from vidphys.experiments.core.cell import CellTask
from vidphys.runs.records import Recorder
from vidphys.shooting.aim import aim
from vidphys.shooting.step import roll

HELD_OUT = 4  # one clip in so many
NUDGE = 1e-3  # of a start's momentum, whose growth is followed
GROWTH_FRAMES = 8  # 0.64 s: the study's n dt, as its figure of 6.9 implies


def momentum_floor(head: Head, tracks: Tensor) -> float:
    """Squared momentum error of forecasts over the windows' own squared momentum, median.

    Forecasts start at the state that the head carries from a window's first frame to its second;
    the momenta that they are held to are central differences.
    """
    batch = windows(tracks, AHEAD + 3)
    law = unit_law(len(batch))
    start = aim(head, batch[:, 0], batch[:, 1], law, INTERVAL / EVERY, EVERY)
    with torch.no_grad():
        told = roll(head, start, law, AHEAD + 1, INTERVAL / EVERY, EVERY)
    seen = central_difference(batch, law.mass, INTERVAL)
    miss = (told.p - seen.p).square().sum((1, 2, 3))
    return float((miss / seen.p.square().sum((1, 2, 3))).quantile(0.5))


def compounding(head: Hamiltonian, tracks: Tensor) -> float:
    """Growth of the square of a small error of the start, by the port alone, over 0.64 s.

    The distance of neighbouring rollouts, over the same with the port taken away.
    """
    precise = copy.deepcopy(head).double()
    bare = Hamiltonian(precise.kinetic, precise.potential)
    return _spread(precise, tracks) / _spread(bare, tracks)


def _spread(head: Head, tracks: Tensor) -> float:
    law, dt = unit_law(len(tracks)).map(Tensor.double), INTERVAL / EVERY
    start = central_difference(tracks[:, :3].double(), law.mass, INTERVAL)[:, 0]
    with torch.no_grad():
        ends = [
            roll(head, PhaseState(start.q, p), law, GROWTH_FRAMES, dt, EVERY).p[:, -1]
            for p in (start.p, start.p * (1 + NUDGE))
        ]
    return float((ends[1] - ends[0]).square().sum((1, 2)).quantile(0.5))


def run_second_law(task: CellTask) -> None:
    """Rates, reversed clips, and the energy balance on the same tracks: both worlds, both ways."""
    for seed in task.seeds:
        still = film(attracted, seed)
        damped = film(total(attracted, drag(STUDY_RATE, 1)), seed)
        _Seed(task, seed, still, damped).run()


@dataclass(frozen=True)
class _Seed:
    """One seed's clips of a world without friction and of one with."""

    task: CellTask
    seed: int
    still: Film
    damped: Film

    def run(self) -> None:
        forward = self.orders("pixels", self.still.seen, self.damped.seen)
        self.orders("oracle", self.still.truth, self.damped.truth)
        self.orders("auxiliary", self.still.seen, self.damped.seen, balance=1.0)
        self.arrow(forward)
        self.balance()

    def rows(self, part: str, head: str) -> Recorder:
        return recorder(self.task, self.seed, part, head, "renderer", "float32")

    def train(self, tracks: Tensor, port: str, balance: float = 0.0) -> Hamiltonian:
        train = tracks[: -len(tracks) // HELD_OUT]
        return train_port(train, port, self.task.pixel.track_steps, self.seed, balance)

    def orders(self, part: str, still: Tensor, damped: Tensor, balance: float = 0.0) -> Hamiltonian:
        """The rates that a port of one sign learns in both worlds; returns the damped head."""
        heads = [self.train(tracks, POSITIVE, balance) for tracks in (still, damped)]
        rates = [rate_of(head) for head in heads]
        rows = self.rows(part, POSITIVE)
        rows.add_value("rate_conservative", rates[0])
        rows.add_value("rate_damped", rates[1])
        rows.add_value("rate_error", abs(rates[1] / STUDY_RATE - 1))
        rows.add_value("ordered", float(rates[1] > rates[0]))
        return heads[1]

    def arrow(self, positive: Hamiltonian) -> None:
        """What clips that run backwards cost a port of one sign, and its twin of either."""
        tracks = self.damped.seen
        held_out = tracks[-len(tracks) // HELD_OUT :]
        ways = {"forward": (tracks, held_out), "reversed": (tracks.flip(1), held_out.flip(1))}
        floors: dict[tuple[str, str], float] = {}
        for port in (POSITIVE, FREE):
            rows = self.rows("reversed" if port == POSITIVE else "twin", port)
            for way, (train, test) in ways.items():
                known = port == POSITIVE and way == "forward"
                head = positive if known else self.train(train, port)
                floors[port, way] = momentum_floor(head, test)
                rows.add_value(f"floor_{way}", floors[port, way])
                rows.add_value(f"rate_{way}", rate_of(head))
            rows.add_value("floor_ratio", floors[port, "reversed"] / floors[port, "forward"])
            if port == FREE:
                rows.add_value("compounding", compounding(head, held_out.flip(1)))
        contrast = floors[POSITIVE, "reversed"] / floors[FREE, "reversed"]
        self.rows("reversed", POSITIVE).add_value("contrast", contrast)

    def balance(self) -> None:
        """The energy balance on what was read from the pixels."""
        rows = self.rows("balance", "energy-balance")
        still = corrected_rate(self.still.motion(), potential).value
        rows.add_value("rate_conservative", abs(still))
        rate = corrected_rate(self.damped.motion(), potential).value
        rows.add_value("rate_error", abs(rate / STUDY_RATE - 1))
