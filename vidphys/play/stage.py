"""One model with the starts that it is rolled from, and what its answers stand beside."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field, replace
from typing import Any, cast

import torch
from torch import Tensor

from dynamics import INTEGRATORS, Head, Parameters, PhaseState
from dynamics.compiled import CompiledHead, form_of
from dynamics.compiled.head import PARTS
from vidphys.data.charts import Chart
from vidphys.errors import InputError
from vidphys.play.asked import Asked
from vidphys.reading.laws import MASS, PAIR, SIGNED, Law
from vidphys.reading.seen import Seen
from vidphys.scenes import Scene

AT_ONCE = 64  # episodes that are rolled at every change
MOST_MASSES = 6  # bodies whose masses have a slider each
COUPLINGS = (-2.0, 2.0)
FACTORS = {True: (-2.0, 2.0), False: (0.0, 3.0)}  # of numbers whose sign has a meaning, and others
POSITIVE = (0.2, 5.0)  # of what cannot be nothing


@dataclass(frozen=True)
class View:
    """From a model's own coordinates and time to those that are drawn.

    Args:
        length: drawn units in one of the model's.
        seconds: in one of the model's units of time.
        origin: of the model's coordinates in the drawn ones, ``(d,)``.
        chart: of a model that counts along a curve in the picture.
    """

    length: float = 1.0
    seconds: float = 1.0
    origin: Tensor | None = None
    chart: Chart | None = None

    def place(self, q: Tensor) -> Tensor:
        """Coordinates ``(..., d)`` as they are drawn."""
        if self.chart is not None:
            return self.chart.place(q)
        return self.length * q if self.origin is None else self.length * q + self.origin.to(q)

    def coordinate(self, places: Tensor) -> Tensor:
        """Inverse of :meth:`place`."""
        if self.chart is not None:
            return self.chart.coordinate(places)
        moved = places if self.origin is None else places - self.origin.to(places)
        return moved / self.length


@dataclass(frozen=True)
class Stage:
    """What can be played with.

    Args:
        name: of it.
        head: the model as it was trained.
        quick: the same in the form that rolls fastest, where it has one.
        start: of each episode, ``(e, n, d)``, in the precision of the model.
        params: of each episode.
        dt: of a step of its own, in its unit of time.
        scene: gives the truth, where there is one.
        twin: the model without structure that was trained beside it, with its step.
        view: how it is drawn.
        coupled: whether the law has a coupling.
        seen: how far the recording reached that the model is of, as it is drawn.
        notes: what must be said of it.
        kept: of integrators, the model with that one.
    """

    name: str
    head: Head
    start: PhaseState
    params: Parameters
    dt: float
    scene: Scene | None = None
    quick: CompiledHead | None = None
    twin: tuple[Head, float] | None = None
    view: View = View()
    coupled: bool = True
    seen: Seen | None = None
    notes: tuple[str, ...] = ()
    kept: dict[str, Head] = field(default_factory=dict, repr=False, compare=False)

    @property
    def episodes(self) -> int:
        """How many starts there are."""
        return len(self.start.q)

    def compiled(self) -> Stage:
        """The same with the model also in the form that rolls fastest, or a note of why not."""
        form = form_of(self.head, self.start, self.params, None, self.dt, substeps=False)
        if isinstance(form.head, CompiledHead):
            return replace(self, quick=form.head)
        return replace(self, notes=(*self.notes, f"not compiled, and slower for it: {form.why}"))

    def part(self, episode: int) -> tuple[int, Stage]:
        """The :data:`AT_ONCE` episodes among which one is, and the number of the first of them.

        Raises:
            InputError: there is no such episode.
        """
        if episode >= self.episodes:
            raise InputError(f"play: episode {episode}: there are {self.episodes}, counted from 0")
        first = episode // AT_ONCE * AT_ONCE
        return first, self.some(first, AT_ONCE)

    def some(self, first: int, count: int) -> Stage:
        """So many of the episodes, from one on."""
        part = slice(first, first + count)
        return replace(self, start=self.start[part], params=self.params[part])

    @property
    def integrators(self) -> list[str]:
        """Names of those that can step it; none where the step is a part of the model."""
        if not hasattr(self.head, "integrator") or not hasattr(self.head, "field"):
            return []
        separable = cast(Any, self.head).field(self.params).separable
        methods = [m for m in INTEGRATORS.values() if m.restarts]  # it is rolled in pieces
        return [m.name for m in methods if separable or not m.needs_separable]

    def told(self) -> dict[str, Any]:
        """What the page is told of it: starts, sliders, steps."""
        mass = self.params.mass.unsqueeze(-1)
        speed = self.start.p / mass * (self.view.length / self.view.seconds)
        own = getattr(getattr(self.head, "integrator", None), "name", None)
        return {
            "cell": self.name,
            "episodes": self.episodes,
            "at_once": AT_ONCE,
            "q": _plain(self.view.place(self.start.q)),
            "v": None if self.view.chart is not None else _plain(speed),
            "coupling": _plain(self.params.coupling) if self.coupled else None,
            "couplings": COUPLINGS,
            "mass": _plain(self.params.mass),
            "factors": self.factors(),
            "integrators": self.integrators,
            "integrator": own,
            "dt": self.dt * self.view.seconds,
            "fixed_step": self.head.dt is not None,
            "truth": self.scene is not None,
            "twin": self.twin is not None,
            "notes": list(self.notes),
        }

    def factors(self) -> dict[str, tuple[float, float]]:
        """Numbers of the law that can be multiplied, each with the least and the largest factor."""
        bodies = self.params.mass.shape[-1]
        names = [x for x in Law(self.head, self.params).quantities if x != PAIR]
        alone = bodies == 1 or bodies > MOST_MASSES
        names = [x for x in names if not x.startswith(MASS) or (x == MASS) is alone]
        ranges = {"restitution": (0.0, 1.0), "length": POSITIVE}
        return {
            name: POSITIVE if name.startswith(MASS) else ranges.get(name, FACTORS[name in SIGNED])
            for name in names
        }

    def head_by(self, integrator: str | None) -> Head:
        """The model, stepped by another integrator where one is named; fast where that can be.

        Raises:
            InputError: it cannot be.
        """
        own = getattr(getattr(self.head, "integrator", None), "name", None)
        if integrator not in (None, own, *self.integrators):
            can = ", ".join(self.integrators) or "none but the model's own"
            raise InputError(f"play: integrator {integrator}: this model has {can}")
        name = integrator or own
        head = self.head if self.quick is None or name not in PARTS else self.quick
        if name is None or name == own:
            return head
        if name not in self.kept:
            other = copy.copy(head)
            other.integrator = INTEGRATORS[name]  # type: ignore[assignment]
            if isinstance(other, CompiledHead):
                other.packed = {}  # what it runs on was chosen for another integrator
            self.kept[name] = other
        return self.kept[name]

    def started(self, asked: Asked) -> PhaseState:
        """The starts, one of them changed as it was asked.

        Raises:
            InputError: another number of bodies.
        """
        one, start = asked.episode, self.start
        shape = tuple(self.view.place(start.q[one]).shape)
        q, p = start.q.clone(), start.p.clone()
        if asked.q is not None:
            q[one] = self.view.coordinate(_given("q", asked.q, shape)).to(q)
        if asked.v is not None:
            if self.view.chart is not None:
                raise InputError("play: v: a body on a curve keeps its velocity")
            speed = _given("v", asked.v, shape).to(p) * (self.view.seconds / self.view.length)
            p[one] = speed * self.params.mass[one].unsqueeze(-1)
        return PhaseState(q, p)

    def law(self, head: Head, asked: Asked) -> Law:
        """A model and what it is told, under the law that was asked.

        Raises:
            InputError: it has no such number.
        """
        changed = {name: factor for name, factor in asked.factors.items() if factor != 1}
        for name, factor in changed.items():
            low, high = self.factors().get(name, (-torch.inf, torch.inf))
            if not low <= factor <= high:
                raise InputError(f"play: {name} {factor:g}: a factor from {low:g} to {high:g}")
        law = Law(head, self.params)
        if changed and isinstance(head, CompiledHead):  # a pair law: all it has is what it is told
            law = replace(law, params=Law(self.head, self.params).changed(changed).params)
        elif changed:
            law = law.changed(changed)
        if asked.coupling is None:
            return law
        if not self.coupled:
            raise InputError("play: coupling: this model has no force between its bodies")
        return replace(law, params=law.params.with_coupling(asked.coupling))


def _plain(x: Tensor) -> Any:
    """Numbers of each episode: one, or a flat list."""
    if x.ndim == 1:
        return [round(v, 6) for v in x.double().tolist()]
    return [[round(v, 6) for v in row] for row in x.double().flatten(1).tolist()]


def _given(name: str, rows: list[list[float]], shape: tuple[int, ...]) -> Tensor:
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        raise InputError(f"play: {name}: needs {shape[0]} bodies of {shape[1]} numbers")
    return torch.tensor(rows, dtype=torch.float64)
