"""A change, rolled: the model first, then the truth, then the twin, in pieces as they come."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from dynamics import DynamicsWarning, Head, Parameters, PhaseState, Rollout, rollout
from dynamics.compiled import CompiledHead
from dynamics.domain import EXTENTS, FAR, extents
from vidphys.errors import InputError
from vidphys.play.asked import Asked
from vidphys.play.pieces import in_pieces
from vidphys.play.rows import numbers, table
from vidphys.play.stage import Stage
from vidphys.reading.laws import Law
from vidphys.reading.seen import BEYOND

STORED = 200  # states that are kept of a rollout, about
FEW = 8  # episodes of the twin; fewer do not roll in fused loops
DRAWING = 0.04  # seconds that a page takes, which wants both cores


@dataclass(frozen=True)
class Piece:
    """Some of an answer.

    Args:
        about: as JSON: ``role`` (``model``, ``truth``, ``twin``, ``held`` or ``table``; a ``pause``
            has nothing but ``seconds``, which the page needs to draw), and of places ``episode``,
            the first of them, ``first``, the stored state that they begin at, ``dt``, the seconds
            between two; what was found of them.
        places: as they are drawn, ``(e, t, n, d)``.
    """

    about: dict[str, Any]
    places: Tensor | None = None


class How(NamedTuple):
    """By which steps.

    Args:
        steps: how many.
        dt: seconds of each.
        every: which is stored.
        once: all in one go, for they take no time.
        substeps: see :func:`dynamics.rollout`; without, what a step does not resolve is said.
    """

    steps: int
    dt: float
    every: int
    once: bool
    substeps: bool


@dataclass
class Kept:
    """What of a rollout is needed after it: states of all episodes so far."""

    states: list[PhaseState] = field(default_factory=list)

    @property
    def whole(self) -> PhaseState | None:
        """All instants, ``(e, t, n, d)``; nothing where nothing was rolled."""
        if not self.states:
            return None
        return PhaseState(*(torch.cat([getattr(s, x) for s in self.states], 1) for x in "qp"))

    @property
    def stored(self) -> int:
        """How many instants there are."""
        return sum(s.q.shape[1] for s in self.states)


def answers(stage: Stage, asked: Asked) -> Iterator[Piece | None]:
    """All that is to be shown of a change: the episodes beside the one that is looked at.

    Where the next piece takes long, ``None`` comes before it, to stop at if the change is old.

    Raises:
        InputError: something that this model cannot be asked.
    """
    first, part = stage.part(asked.episode)
    there = asked.model_copy(update={"episode": asked.episode - first})
    for piece in _answers(part, there):
        yield piece and replace(piece, about=_counted(piece.about, first))


def _counted(about: dict[str, Any], first: int) -> dict[str, Any]:
    """The same with episodes counted among all."""
    return {**about, "episode": about.get("episode", 0) + first}


def _answers(stage: Stage, asked: Asked) -> Iterator[Piece | None]:
    start, law, how = begun(stage, asked)
    seconds, between = how.steps * how.dt, how.every * how.dt
    model = Kept()
    yield from of_model(stage, law, start, how, asked, model)
    yield Piece({"role": "pause", "seconds": DRAWING})
    if stage.scene is not None:
        truth = Kept()
        yield from of_truth(stage, asked, start, law.params, how, truth)
        rows = table(stage, law.params, model.whole, truth.whole)
        yield Piece({"role": "table", "seconds": between * (model.stored - 1), "rows": rows})
    else:
        yield from _held(stage, stage.head_by(asked.integrator), how)
    if stage.twin is not None:
        yield from _twin(stage, asked, start, law.params, seconds)


def begun(stage: Stage, asked: Asked) -> tuple[PhaseState, Law, How]:
    """Where a change begins: the starts, the law, the steps.

    Raises:
        InputError: something that this model cannot be asked.
    """
    head = stage.head_by(asked.integrator)
    if stage.head.dt is not None and asked.dt is not None:
        raise InputError(f"play: dt: this model is a map of {stage.head.dt:g} s a step")
    dt = stage.dt if asked.dt is None else asked.dt / stage.view.seconds
    start, law = stage.started(asked), stage.law(head, asked)
    every = max(1, asked.steps // STORED)
    fused = isinstance(law.head, CompiledHead)  # taken apart, its steps take seconds
    how = How(asked.steps // every * every, dt, every, fused, not fused)
    return _as_fast(start, stage.params, law.params), law, how


def _as_fast(start: PhaseState, before: Parameters, after: Parameters) -> PhaseState:
    """A body that has become heavier is as fast as it was."""
    if after.mass is before.mass:
        return start
    return PhaseState(start.q, start.p * (after.mass / before.mass).unsqueeze(-1))


def of_model(
    stage: Stage, law: Law, start: PhaseState, how: How, asked: Asked, kept: Kept
) -> Iterator[Piece | None]:
    """The model's way, in pieces."""
    steps, dt, every, once, substeps = how

    def roll(state: PhaseState, params: Parameters, count: int, every: int) -> Rollout:
        return rollout(law.head, state, params, count, dt, every, seed=0, substeps=substeps)

    began, told = time.perf_counter(), set[type[DynamicsWarning]]()

    def shown(first: int, found: Rollout) -> Piece:
        kept.states.append(found.states)
        places = stage.view.place(found.states.q)
        new = [each for each in found.findings if each.kind not in told]
        told.update(each.kind for each in new)
        one = found.states[asked.episode].map(lambda x: x.unsqueeze(0))
        about = {
            **_seconds(stage, "model", 0, first, every * dt),
            "steps": steps,
            "every": every,
            "stored": steps // every + 1,
            "left": _left(stage, law.head, found.states, places),
            "bad": found.first_bad.tolist(),
            "said": [_at(first * every, each.text) for each in new],
            "backend": found.backend,
            "energy": _energies(stage, law, one, asked.episode),
            "ms": round(1000 * (time.perf_counter() - began), 1),
        }
        return Piece(about, places)

    yield from _each(in_pieces(roll, start, law.params, steps, every, once), shown)


def of_truth(
    stage: Stage, asked: Asked, start: PhaseState, params: Parameters, how: How, kept: Kept
) -> Iterator[Piece | None]:
    """The reference by its own step, stored as near to the model's instants as that allows."""
    scene = stage.scene
    assert scene is not None
    untold = [x for x in asked.factors if asked.factors[x] != 1 and not _is_told(stage, x)]
    if untold:
        said = f"the truth is not known with another {', '.join(untold)}"
        yield Piece({"role": "truth", "said": [said]})
        return
    every = max(1, round(how.every * how.dt / scene.dt))
    steps = max(1, round(how.steps * how.dt / scene.dt / every)) * every

    def roll(state: PhaseState, law: Parameters, count: int, every: int) -> Rollout:
        return scene.simulate(state, law, count, every)

    start, params = start.map(torch.Tensor.double), params.map(torch.Tensor.double)

    def shown(first: int, found: Rollout) -> Piece:
        kept.states.append(found.states)
        one = found.states[asked.episode].map(lambda x: x.unsqueeze(0))
        told = params[asked.episode : asked.episode + 1]
        energy = {"true": numbers(scene.energy(one, told)[0])}
        about = _seconds(stage, "truth", 0, first, every * scene.dt)
        return Piece({**about, "energy": energy}, stage.view.place(found.states.q))

    yield from _each(in_pieces(roll, start, params, steps, every), shown)


def _is_told(stage: Stage, name: str) -> bool:
    """Whether a number is one that the truth is told as well."""
    return name.startswith("mass") or name in stage.params.scalars


def _twin(
    stage: Stage, asked: Asked, start: PhaseState, params: Parameters, seconds: float
) -> Iterator[Piece | None]:
    """Of the episode that is looked at, and of some beside it, which cost nothing."""
    assert stage.twin is not None
    head, dt = stage.twin
    begin = max(0, min(asked.episode, stage.episodes - FEW))
    some = slice(begin, begin + FEW)
    steps = max(1, round(seconds / dt))
    every = max(1, steps // STORED)
    steps -= steps % every

    def roll(state: PhaseState, law: Parameters, count: int, every: int) -> Rollout:
        return rollout(head, state, law, count, dt, every)

    def shown(first: int, found: Rollout) -> Piece:
        about = _seconds(stage, "twin", begin, first, every * dt)
        return Piece({**about, "bad": found.first_bad.tolist()}, stage.view.place(found.states.q))

    try:
        yield from _each(in_pieces(roll, start[some], params[some], steps, every), shown)
    except ValueError as error:
        yield Piece({"role": "twin", "said": [str(error)]})


def _held(stage: Stage, head: Head, how: How) -> Iterator[Piece | None]:
    """What the model says of the law that held, from where it was, to see a change beside."""
    steps, dt, every, once, _ = how

    def roll(state: PhaseState, params: Parameters, count: int, every: int) -> Rollout:
        return rollout(head, state, params, count, dt, every, seed=0)

    def shown(first: int, found: Rollout) -> Piece:
        about = _seconds(stage, "held", 0, first, every * dt)
        return Piece(about, stage.view.place(found.states.q))

    yield from _each(in_pieces(roll, stage.start, stage.params, steps, every, once), shown)


def _each(
    found: Iterator[tuple[int, Rollout] | None], shown: Callable[[int, Rollout], Piece]
) -> Iterator[Piece | None]:
    """What is shown of parts of a rollout, as they come."""
    for part in found:
        yield part and shown(*part)


def _left(stage: Stage, head: Head, states: PhaseState, places: Tensor) -> list[int]:
    """Of each episode the first stored state far from the training or the recording, or -1."""
    if stage.seen is not None:
        far = torch.from_numpy(stage.seen.reach(places.numpy()) > BEYOND).any(-1).any(-1)
        return torch.where(far.any(-1), far.int().argmax(-1), -1).tolist()
    known = dict(zip(EXTENTS, head.domain.tolist(), strict=True))
    watched = [name for name in head.depends_on if math.isfinite(known[name])]
    if not watched:
        return [-1] * len(states.q)
    reached = extents(states, head.box)
    far = torch.stack(
        [reached[..., EXTENTS.index(name)] > FAR * known[name] for name in watched], -1
    ).any(-1)
    return torch.where(far.any(-1), far.int().argmax(-1), -1).tolist()


def _energies(stage: Stage, law: Law, states: PhaseState, episode: int) -> dict[str, Any]:
    """By the true law along the model's way, and by the model itself, where they are."""
    told, found = law.params[episode : episode + 1], {}
    with torch.no_grad():
        if stage.scene is not None:
            found["true"] = numbers(stage.scene.energy(states, told)[0])
        # Of few states a network is sooner asked than its spline, and it is what was trained.
        own: Any = stage.head if isinstance(law.head, CompiledHead) else law.head
        if hasattr(own, "energy"):
            wide = told.map(lambda x: x.unsqueeze(1))
            found["own"] = numbers(own.energy(states, wide)[0])
    return found


def _seconds(stage: Stage, role: str, episode: int, first: int, between: float) -> dict[str, Any]:
    dt = between * stage.view.seconds
    return {"role": role, "episode": episode, "first": first, "dt": dt}


def _at(step: int, text: str) -> str:
    return f"{text} (steps counted from {step})" if step else text
