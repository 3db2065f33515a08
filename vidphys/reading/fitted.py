"""A model of the terms that a diagnosis found, trained on its tracks: kept, rolled, and changed."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from binders import Tracks
from dynamics import Head, Parameters, PhaseState, build, from_config, rollout, to_config
from dynamics.bath import Bath
from dynamics.potentials import PairPotential
from dynamics.terms import HeadTerm
from vidphys.diagnose.recordings.evened import evened
from vidphys.diagnose.recordings.motion import Motion
from vidphys.errors import InputError
from vidphys.reading.laws import Law
from vidphys.reading.seen import Seen
from vidphys.reading.steering import Aim, Push, Way, steer
from vidphys.runs import checkpoint
from vidphys.shooting.initial_state import by_shooting
from vidphys.shooting.step import model_step
from vidphys.training.few import is_few, last_state

FILE = "specified.json"
EVEN = 0.1  # share of an interval by which frames may come at other times
PATHS = 64  # of a heat bath, over which a forecast is the mean
CONTEXT = 16  # frames that lead a network to its last state


@dataclass(frozen=True)
class Units:
    """What a model counts in, so that its numbers are near one whatever the tracks are in.

    Args:
        length: the spread of the positions, in the unit of the tracks; 1 for angles.
        seconds: in which a body goes as far at its usual speed.
    """

    length: float
    seconds: float

    @classmethod
    def of(cls, motion: Motion, angles: bool = False) -> Units:
        """Of tracks that move."""
        spread = float(np.nanstd(motion.positions, axis=(0, 1, 2)).max())
        speed = float(np.sqrt(np.nanmean(np.diff(motion.positions, axis=1) ** 2))) / motion.interval
        return cls(1.0 if angles else spread, spread / speed) if speed > 0 else cls(1.0, 1.0)

    def motion(self, motion: Motion) -> Motion:
        """The same tracks, counted so."""
        positions, times = motion.positions / self.length, motion.times / self.seconds
        return replace(motion, positions=positions, times=times)


@dataclass(frozen=True)
class Rolled:
    """Where bodies go, in the unit of the tracks.

    Args:
        times: seconds ``(r,)``, those of the recording, from the state on that it starts from.
        positions: ``(r, n, d)``; the mean of many paths where there is a heat bath.
        spread: standard deviation of those paths, ``(r, n, d)``, where there are any.
        findings: what is wrong with it, in words.
        push: that a body was given at the start, where one was looked for.
    """

    times: np.ndarray
    positions: np.ndarray
    spread: np.ndarray | None = None
    findings: tuple[str, ...] = ()
    push: Push | None = None

    def at(self, times: np.ndarray) -> np.ndarray:
        """Positions at other times within, ``(t,)`` to ``(t, n, d)``, on straight lines."""
        flat = self.positions.reshape(len(self.times), -1).T
        path = np.stack([np.interp(times, self.times, column) for column in flat], -1)
        return path.reshape(len(times), *self.positions.shape[1:])


@dataclass(frozen=True)
class Fitted:
    """A model in its own units, and what is needed to use it on tracks.

    Args:
        term: of the model, in the unit of the tracks.
        head: built of it, in its own units.
        units: those.
        origin: of the model's coordinates in those of the tracks, ``(d,)``.
        params: batch of one, in its own units.
        interval: seconds between frames that it was trained on.
        seen: how far the recording reached that it was trained on.
        plane: axes of the plane or line of space that it is of, ``(2, 3)`` or ``(1, 3)``, where it
            was told in one.
    """

    term: HeadTerm
    head: Head
    units: Units
    origin: np.ndarray
    params: Parameters
    interval: float
    seen: Seen
    plane: list[list[float]] | None = None

    @property
    def kicked(self) -> bool:
        """Whether a heat bath makes its paths random."""
        return any(isinstance(part, Bath) for part in self.head.modules())

    def law(self, motion: Motion) -> Parameters:
        """What the model is told of each clip, at its last frame."""
        law = self.params.map(lambda x: x.expand(motion.clips, *x.shape[1:]))
        law = law.later(torch.from_numpy(motion.times[:, -1]).float() / self.units.seconds)
        if motion.coupling is None:
            return law
        return law.with_coupling(torch.from_numpy(motion.coupling).float())

    def tracks(self, motion: Motion) -> Tracks:
        """Tracks as the model counts, at even times."""
        own = self.units.motion(even(motion))
        positions = np.nan_to_num(own.positions - self.origin / self.units.length)
        confidence = torch.from_numpy(own.seen).float()
        times = torch.from_numpy(own.times[0])
        return Tracks(torch.from_numpy(positions).float(), confidence, times)

    def last(self, motion: Motion) -> PhaseState:
        """The state at the last frame, one for each clip.

        Raises:
            InputError: other bodies or dimensions than the model's.
        """
        self.check(motion)
        interval = motion.interval / self.units.seconds
        head, tracks, law = self.head, self.tracks(motion), self.law(motion)
        if is_few(head) and not self.kicked:
            return last_state(head, tracks, law, interval)
        if self.kicked:  # what a bath forgets says nothing of where bodies are now
            law = law.with_scalar("temperature", 0.0)
        few = Tracks(
            tracks.positions[:, -CONTEXT:], tracks.confidence[:, -CONTEXT:], tracks.times[-CONTEXT:]
        )
        return by_shooting(head, few, law, interval)

    def roll(
        self,
        start: PhaseState,
        began: float,
        frames: int,
        interval: float,
        law: Parameters,
        aim: Aim | None = None,
    ) -> Rolled:
        """Roll on.

        Args:
            start: of :meth:`last`, a batch of one.
            began: its time, seconds.
            frames: to roll.
            interval: seconds from one to the next.
            law: that is to hold, a batch of one.
            aim: look for a push that takes a body somewhere by then, and roll with it.

        Raises:
            InputError: a wrong aim, or a heat bath, whose pushes nobody foresees.
        """
        dt, every = model_step(interval / self.units.seconds)
        push = None
        if aim is not None:
            if self.kicked:
                raise InputError("`reach`: a heat bath takes each path elsewhere; take it away")
            way = Way(self.head, law, dt, self._place, self.units.seconds)
            push = steer(way, start[:1], frames * every, aim)
            start = push.state.map(lambda x: x.to(start.q.dtype))
        paths = PATHS if self.kicked else 1
        many = start.map(lambda x: x[:1].expand(paths, *x.shape[1:]))
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always")
            told = law.map(lambda x: x.expand(paths, *x.shape[1:]))
            rolled = rollout(self.head, many, told, frames * every, dt, every, seed=0)
        q = self._place(rolled.states.q.double()).numpy()
        said = tuple(" ".join(str(each.message).split()) for each in found)
        times = began + interval * np.arange(frames + 1)
        spread = q.std(0, ddof=1) if self.kicked else None
        return Rolled(times, q.mean(0), spread, said, push)

    def _place(self, q: Tensor) -> Tensor:
        """From the model's coordinates to those of the tracks."""
        return self.units.length * q + torch.from_numpy(self.origin)

    def under(self, factors: Mapping[str, float], coupling: float | None = None) -> Fitted:
        """The same model under another law.

        Args:
            factors: on its quantities, see :meth:`vidphys.reading.laws.Law.changed`.
            coupling: in place of the one that held.

        Raises:
            InputError: the model has no such number.
        """
        law = Law(self.head, self.params).changed(factors)
        params = law.params
        if coupling is not None:
            if not any(isinstance(part, PairPotential) for part in self.head.modules()):
                raise InputError("`coupling`: this model has no force between its bodies")
            params = params.with_coupling(coupling)
        return replace(self, head=law.head, params=params)

    def check(self, motion: Motion) -> None:
        """Refuse tracks of another scene.

        Raises:
            InputError: other bodies or dimensions than the model's.
        """
        shape = len(self.params.mass[0]), len(self.origin)
        if (motion.bodies, motion.space) != shape:
            raise InputError(
                f"the model is of {shape[0]} bodies in {shape[1]} dimensions, the tracks are of "
                f"{motion.bodies} in {motion.space}"
            )


def even(motion: Motion) -> Motion:
    """The motion, read off at even times where its own are not."""
    # not each gap by itself: stamps rounded to milliseconds drift from their own median
    grid = motion.times[:, :1] + motion.interval * np.arange(motion.times.shape[1])
    if np.abs(motion.times - grid).max() <= EVEN * motion.interval:
        return motion
    return evened(motion)


def built(
    term: HeadTerm, units: Units, params: Parameters, interval: float, bodies: int, space: int
) -> Head:
    """The untrained model of a term, in units of its own."""
    dt = model_step(interval / units.seconds)[0]
    counted = term.counted_in(units.length, units.seconds)
    return build(counted, bodies, dt, space, params.flat.shape[-1])


def save_fitted(folder: Path, fitted: Fitted, step: int) -> None:
    """Write a model that was trained for so many steps into a folder of checkpoints."""
    law = fitted.params
    meta = {
        "step": step,
        "terms": to_config(fitted.term),
        "origin": list(fitted.origin),
        "units": asdict(fitted.units),
        "interval": fitted.interval,
        "bodies": len(law.mass[0]),
        "space": len(fitted.origin),
        "conditions": law.flat.shape[-1],
        "mass": law.mass[0].tolist(),
        "scalars": {name: float(value[0]) for name, value in law.scalars.items()},
        "seen": asdict(fitted.seen),
        "plane": fitted.plane,
    }
    checkpoint.save(folder / FILE, dict(fitted.head.state_dict()), meta)


def load_fitted(run: Path) -> Fitted:
    """The model that `vidphys fit` left in a run folder.

    Raises:
        InputError: there is none, or it is of another version.
    """
    path = run / "checkpoints" / "heads" / FILE
    if not path.is_file():
        raise InputError(f"{run}: no fitted model in it; give the folder of `vidphys fit`")
    tensors, meta = checkpoint.load(path)
    if "seen" not in meta:
        raise InputError(f"{run}: of another version of vidphys; fit again in another folder")
    units, term = Units(**meta["units"]), from_config(meta["terms"])
    params = law_of(meta["mass"], meta["scalars"])
    size = meta["bodies"], meta["space"]
    head = built(term, units, params, meta["interval"], *size)
    head.load_state_dict(tensors)
    origin, seen = np.asarray(meta["origin"]), Seen(**meta["seen"])
    told = meta["interval"], seen, meta.get("plane")
    return Fitted(term, head.eval(), units, origin, params, *told)


def law_of(mass: Any, scalars: Mapping[str, float]) -> Parameters:
    """A batch of one, of coupling one."""
    told = {name: torch.tensor([value]) for name, value in scalars.items()}
    return Parameters(torch.ones(1), torch.tensor([mass], dtype=torch.float32), None, told)
