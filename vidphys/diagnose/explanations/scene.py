"""The scene of fitted laws: as terms from which exactly that model is built."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dynamics import terms
from dynamics.terms import HeadTerm, PortTerm, PotentialTerm
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.mechanisms.charts import Angle, Arc, Bound, Chart, Line, Turned
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.mechanism import Mechanism
from vidphys.diagnose.mechanisms.rods import RodsFit
from vidphys.diagnose.mechanisms.terms import FORCING
from vidphys.diagnose.recordings.units import GRAVITY

SLOWEST = 1e-6  # per second, of a friction that is there
BETWEEN = 6  # points of a fitted curve from one of the model's, which is smooth between its own


def as_scene(mechanism: Mechanism, interval: float, explained: bool, space: int) -> dict[str, Any]:
    """The specification of laws; see :func:`as_specification`.

    Args:
        mechanism: the laws.
        interval: seconds between frames.
        explained: whether they have all of the motion.
        space: dimensions of the positions.
    """
    laws: dict[int, HeadTerm] = {}
    numbers: dict[str, tuple[float, float]] = {}
    masses = np.ones(sum(len(g.bodies) for g in mechanism.groups))
    springs: tuple[terms.Spring, ...] = ()
    contacts: tuple[terms.Contact, ...] = ()
    origin = [0.0] * space
    for group in mechanism.groups:
        fit = group.fit
        if fit.model.law.restoring == "chain":
            rest = float(np.mean([x[0] for x in fit.geometry]))
            rods: HeadTerm = _rods(fit)
            if isinstance(fit, RodsFit):
                rods = _in_picture(fit, rest)
            else:
                origin = [rest]
            held = as_specification(rods, 2, origin, fit.numbers, explained, interval)
            return {**held, "mass": [1.0, 1.0]}
        if fit.model.law.coupled:
            masses[list(group.bodies)] = _masses(fit)
            springs = _springs(fit, masses)
        if isinstance(fit.model.law, Colliding):
            told = {name: value for name, (value, _) in fit.numbers.items()}
            masses[list(group.bodies)] = fit.model.law.masses(told)
            contacts += _contacts(fit, group.bodies)
        for place, body in enumerate(group.bodies):
            one = _Body(fit, place, float(masses[body]), float(mechanism.begin[-1]))
            laws[body] = one.term()
            if isinstance(one.chart, Angle):
                origin = [float(fit.geometry[place][0])]
        said = f"body {group.bodies[0] + 1}: " if len(mechanism.groups) > 1 else ""
        numbers |= {said + name: number for name, number in fit.numbers.items()}
    ordered = tuple(laws[body] for body in sorted(laws))
    term = ordered[0] if len(ordered) == 1 else terms.Each(ordered, springs, contacts)
    held = as_specification(term, len(ordered), origin, numbers, explained, interval)
    known = mechanism.groups[0].fit.clips[0].inputs
    return {
        **held,
        "mass": masses.tolist(),
        "inputs": [] if known is None else list(known.names),  # by their gains among the numbers
    }


def _in_picture(fit: RodsFit, rest: float) -> terms.OnChain:
    """Two rods whose ends are seen; the upper one's is the first body."""
    down = np.array([np.sin(rest), -np.cos(rest)])
    across = np.array([-down[1], down[0]])
    upper, lower = fit.rods.lengths.tolist()
    return terms.OnChain(_row(fit.rods.pivot), _row(across), _row(down), (upper, lower), _rods(fit))


def _rods(fit: Fit) -> terms.Links:
    """Rods of one length with the fitted numbers; of masses and lengths only these are told."""
    known = {name: value for name, (value, _) in fit.numbers.items()}
    length = GRAVITY * known["link"] / known["swing 2"]
    lower = known["link"] / length**2
    both = known["swing 1"] / (GRAVITY * length)
    inertia = (1 - both * length**2, known["inertia"] - lower * length**2)
    ports = (terms.Drag("linear", "positive", rate=max(known.get("linear", 0.0), SLOWEST)),)
    return terms.Links((length,) * 2, (both - lower, lower), GRAVITY, inertia, ports)


def _masses(fit: Fit) -> np.ndarray:
    """Of bodies between which springs act, from how each answers to them; their mean is one."""
    pulls = np.array([fit.numbers[f"coupling {i + 1}"][0] for i in range(len(fit.model.charts))])
    masses = 1 / pulls
    return masses / masses.mean()


def _springs(fit: Fit, masses: np.ndarray) -> tuple[terms.Spring, ...]:
    law, count = fit.model.law, len(fit.model.charts)
    stiffness = fit.numbers["coupling 1"][0] * float(masses[0]) / max(count - 1, 1)
    hung = law.hung or (0.0,) * count
    return tuple(terms.Spring(i, j, stiffness, apart=hung[j] - hung[i]) for i, j in law.springs)


def _contacts(fit: Fit, bodies: Sequence[int]) -> tuple[terms.Contact, ...]:
    law, rub = fit.model.law, fit.numbers.get("rub", (0.0, 0.0))[0]
    assert isinstance(law, Colliding)
    longer = _Body(fit, 0, 1.0).longer
    restitution = float(np.clip(fit.numbers["restitution"][0], 0.0, 1.0))
    return tuple(
        terms.Contact(
            bodies[c.one],
            bodies[c.two],
            longer * fit.numbers[f"reach {i}"][0],
            restitution,
            rub,
            c.side,
        )
        for i, c in enumerate(law.contacts, 1)
    )


class _Body:
    """One body of a fit, whose law counts time from ``begin`` seconds of the recording on."""

    def __init__(self, fit: Fit, place: int, mass: float, begin: float = 0.0) -> None:
        self.fit, self.law, self.mass, self.begin = fit, fit.model.law, mass, begin
        self.chart: Chart = fit.model.charts[place]
        self.geometry = fit.geometry[place]
        self.collides = isinstance(self.law, Colliding)
        apart = self.law.apart or self.collides
        self.own = f" {place + 1}" if apart and len(fit.model.charts) > 1 else ""
        self.place, self.part = place, fit.model.slices[place]
        self.longer = self._longer()

    def number(self, name: str) -> float:
        return self.fit.numbers[name][0]

    def _longer(self) -> float:
        """Length along a rail over the coordinate that counts it."""
        if not isinstance(self.chart, Line):
            return 1.0
        return float(np.linalg.norm(self._rail()[1]))

    def _rail(self) -> tuple[np.ndarray, np.ndarray]:
        assert isinstance(self.chart, Line)
        size = self.chart.across.shape[1]
        point = self.chart.across @ self.geometry[:size]
        return point, np.array(self.chart.along) + self.chart.across @ self.geometry[
            size : 2 * size
        ]

    def term(self) -> HeadTerm:
        """The body's whole model."""
        if isinstance(self.chart, Bound):
            return self._on_curve(self.chart)
        free = self._free()
        if self.law.restoring == "string":
            centre = self.law.centre(self.fit.numbers)
            return terms.Strung(free, _row(centre), self.number("rest"))
        timed = self._timed()
        law = terms.Clocked(free, timed) if timed else self._walled(free)
        if isinstance(self.chart, Arc):
            lowest, across, up = self.chart.vectors(self.geometry)
            return terms.OnArc(_row(lowest + up), _row(across), _row(-up), law)
        if isinstance(self.chart, Line):
            point, direction = self._rail()
            return terms.OnLine(_row(point), _row(direction), law)
        return law

    def _on_curve(self, chart: Bound) -> terms.OnCurve:
        field = tuple(self.fit.numbers.get(f"force {i}", (0.0, 0.0))[0] for i in (1, 2))
        rubs = "dry" in self.law.frictions
        ports = () if rubs else self._ports()
        free = terms.Hamiltonian(potentials=(terms.Along(field),), ports=ports)
        law = terms.Rubbed(free, max(self.number("dry"), 0.0)) if rubs else free
        points = chart.curve.points
        kept = np.concatenate([points[:-1:BETWEEN], points[-1:]])
        return terms.OnCurve(tuple(map(_row, kept)), law)

    def _free(self) -> terms.Hamiltonian:
        potentials: tuple[PotentialTerm, ...] = (terms.NoPotential(),)
        if self.law.restoring in ("uniform", "string") or self.place in self.law.loose:
            potentials = (terms.Uniform(_row(self._force())),)
        elif self.law.restoring == "elastic":
            potentials = (self._tether(), terms.Uniform(_row(self._force())))
        elif self.law.restoring == "centre":
            potentials = (self._centre(),)
        elif isinstance(self.chart, Turned):
            potentials = (self._elliptic(self.chart),)
        elif self.law.restoring == "trap":
            stiffness = self.number(f"stiffness{self.own}")
            centre = self._force() / stiffness
            potentials = (terms.Trap(self.mass * stiffness, _row(centre), True),)
        elif self.law.restoring == "pendulum":
            potentials = (terms.Pendulum(self.number(f"swing{self.own}")),)
        return terms.Hamiltonian(potentials=potentials, ports=self._ports())

    def _force(self) -> np.ndarray:
        """The steady one on this body."""
        names = self.law.forces
        own = [names[i % len(names)] for i in range(self.part.start, self.part.stop)]
        return self.longer * np.array([self.number(name) for name in own])

    def _tether(self) -> terms.Tether:
        stiffness, rest = self.mass * self.number("stiffness"), self.number("rest")
        return terms.Tether(stiffness, rest, _row(self.law.centre(self.fit.numbers)))

    def _centre(self) -> terms.Centre:
        centre = self.law.centre(self.fit.numbers)
        near = float(np.linalg.norm(centre - self.law.turned_at))
        power = self.law.power({name: value for name, (value, _) in self.fit.numbers.items()})
        return terms.Centre(self.mass * self.number("strength"), power, _row(centre), near)

    def _elliptic(self, chart: Turned) -> terms.EllipticTrap:
        rates = np.array([self.number(f"stiffness {i + 1}") for i in range(chart.size)])
        axes = chart.turned(self.geometry)
        along = axes / np.linalg.norm(axes, axis=1, keepdims=True)
        rows = self.mass * along.T @ np.diag(rates) @ along
        rows = 0.5 * (rows + rows.T)
        return terms.EllipticTrap(tuple(map(_row, rows)), _row(self._force() / rates @ axes))

    def _ports(self) -> tuple[PortTerm, ...]:
        ports: list[PortTerm] = []
        for friction in self.law.frictions:
            unit = {"linear": 1.0, "square": 1 / self.longer}.get(friction, self.longer)
            rate = self.mass * unit * self.number(friction + (self.own if self.collides else ""))
            ports.append(terms.Drag(friction, "positive" if rate > 0 else "free", rate=rate))
        if self.law.turning:
            ports.append(terms.Turning(tuple(self.number(name) for name in self.law.turns)))
        return tuple(ports)

    def _timed(self) -> tuple[terms.TimedTerm, ...]:
        """What changes with the recording's time."""
        values = self.law.later(self.fit.values, -self.begin)
        numbers = dict(zip(self.law.names, values.tolist(), strict=False))  # then the starts
        if self.law.forced:
            along, across, rate = (numbers[name] for name in FORCING)
            return (terms.Sinusoid((along,), (across,), rate),)
        if self.law.lift_fades is not None:
            return (terms.Lift(numbers["lift"], self.law.lift_fades),)
        return ()

    def _walled(self, free: terms.Hamiltonian) -> HeadTerm:
        """Beside the wall that is struck, the first where there are two."""
        own = list(range(len(self.law.walls)))
        if isinstance(self.law, Colliding):
            own = [i for i in own if self.law.bouncing[i] == self.place]
        if not own:
            return free
        i = own[0] + 1
        normal = self.law.walls[own[0]].turned(self.fit.numbers.get(f"turn {i}", (0.0, 0.0))[0])
        restitution = float(np.clip(self.number(f"restitution {i}"), 0.0, 1.0))
        place = self.longer * self.number(f"wall {i}")
        return terms.Walled(free, place, restitution, _row(normal))


def _row(vector: np.ndarray) -> tuple[float, ...]:
    return tuple(float(x) for x in vector)
