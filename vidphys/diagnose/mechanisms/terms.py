"""Which accelerations a law of motion has, by name, and what the numbers of a fit are called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.curve import Curve

RESTORING = ("none", "uniform", "trap", "pendulum", "chain", "centre", "elastic", "string")
FRICTIONS = ("none", "linear", "square", "dry", "linear+dry", "linear+square")
RATES = ("linear", "square", "dry")  # the order in which the kernel takes them
COULOMB = 2.0  # the power of the distance, as of gravity
OVER_TOP = 5.0  # times g over the length, the square of the rate of what goes over the top
FORCING = ("forcing 1", "forcing 2", "forcing rate")  # with its cosine and its sine; radians/s
# The powers of a second that numbers go with, by the first word of their names.
SECONDS = dict.fromkeys(("linear", "turning", "lift", "nearing"), -1)
SECONDS |= dict.fromkeys(("stiffness", "swing", "coupling", "strength"), -2)
SECONDS |= dict.fromkeys(("force", "dry", "gain", "forcing"), -2)

Numbers = Mapping[str, Any]  # by their names: floats of one law, or of many ``(b,)``


@dataclass(frozen=True)
class Wall:
    """A plane that bodies bounce off.

    Args:
        normal: towards it, ``(k,)``, of length one.
        turns: whether the normal is fitted too; one bounce alone does not tell it from what the
            bounce takes along the wall.
        smooth: whether a bounce takes nothing along the wall.
    """

    normal: tuple[float, ...]
    turns: bool = False
    smooth: bool = False

    def turned(self, angle: float | np.ndarray) -> np.ndarray:
        """The normal ``(…, k)`` turned by radians ``(…)``, where there is a plane to turn it in."""
        if len(self.normal) != 2:
            return np.array(self.normal)
        (x, y), c, s = self.normal, np.cos(angle), np.sin(angle)
        return np.stack([c * x - s * y, s * x + c * y], -1)


@dataclass(frozen=True)
class Terms:
    """Accelerations of k coordinates.

    Args:
        coordinates: k.
        restoring: of :data:`RESTORING`; a uniform field, a trap about any centre, what an angle
            hangs in, two rods that hang end on end, by their angles, a fixed place that pushes or
            pulls every body by a power of the distance, or a spring of a rest length from a fixed
            place, in a uniform field.
        friction: of :data:`FRICTIONS`.
        apart: each coordinate has its own trap, or swing, and its own friction.
        coupled: springs between pairs of coordinates, where they are apart.
        ties: those pairs, each in its order; all of them where none is named.
        loose: those of them that have no trap, and are held by these springs alone.
        hung: of pendulums that are coupled, where each hangs along a level line, over their length.
        inputs: how many are known that push the one coordinate, each by a gain times its value.
        forced: a sinusoid of a rate of its own pushes the one coordinate, and is not known.
        walls: that there are.
        turned_at: where a fixed place that pushes or pulls has its strength, ``(d,)``.
        spins: the body is a ball that walls may grip, in the plane; its spin at first is told as
            the speed of its surface over that of its middle.
        lift_fades: share a second by which a lift fades, as the body's spin does, that goes with
            its speed and pushes it across its way, in the plane; ``None``: there is none.
        turning: a force across its way goes with its speed, in the plane or in space, as in a
            magnetic field or a frame that turns.
        nears: the body nears the camera, or goes away from it, at a steady speed: its picture's
            distance from the middle grows as 1 / (1 - nearing t).
        pictured: a camera sees the plane of motion slightly askew; see :mod:`.view`.
        curve: that the body keeps to, by whose length its one coordinate is; the uniform field is
            the plane's, and dry friction a share of what presses the body to the curve.
        upright: that field is along the plane's second axis.
    """

    coordinates: int
    restoring: str = "none"
    friction: str = "none"
    apart: bool = False
    coupled: bool = False
    ties: tuple[tuple[int, int], ...] = ()
    loose: tuple[int, ...] = ()
    hung: tuple[float, ...] = ()
    inputs: int = 0
    forced: bool = False
    walls: tuple[Wall, ...] = ()
    turned_at: tuple[float, ...] = ()
    spins: bool = False
    lift_fades: float | None = None
    turning: bool = False
    nears: bool = False
    pictured: bool = False
    curve: Curve | None = None
    upright: bool = False

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of its numbers, in the order in which a fit has them."""
        k = self.coordinates
        each = [f" {i + 1}" for i in range(k)] if self.apart and k > 1 else [""]
        names = []
        if self.restoring == "trap":
            names += [f"stiffness{x}" for i, x in enumerate(each) if i not in self.loose]
        if self.restoring == "elastic":
            names += ["stiffness", "rest", *self._place]
        if self.restoring == "string":
            names += ["rest", *self._place]
        names += self.forces
        if self.restoring in ("pendulum", "chain"):
            names += [f"swing{x}" for x in each]
        if self.restoring == "chain":
            names += ["link", "inertia"]
        if self.restoring == "centre":
            names += ["strength", "steeper", *self._place]
        if self.coupled:
            names += [f"coupling {i + 1}" for i in range(k)]
        if self.friction != "none":
            names += self.frictions
        names += ["lift"] if self.lift_fades is not None else []
        names += self.turns
        names += [f"gain {i + 1}" for i in range(self.inputs)]
        names += FORCING if self.forced else []
        names += ["nearing"] if self.nears else []
        for number, wall in enumerate(self.walls, 1):
            names += [f"wall {number}", f"restitution {number}"]
            names += self._along(number)
            names += [f"turn {number}"] if wall.turns else []
        names += ["spin"] if self.spins else []
        names += view.NAMES if self.pictured else []
        return tuple(names)

    @property
    def seconds(self) -> tuple[int, ...]:
        """The powers of a second that its numbers go with."""
        return tuple(
            -1 if name == FORCING[-1] else SECONDS.get(name.partition(" ")[0], 0)
            for name in self.names
        )

    @property
    def forces(self) -> tuple[str, ...]:
        """Names of its steady force's numbers, one for each coordinate."""
        if self.curve is not None:
            return self._steady(2)[int(self.upright) :]
        steady = self.restoring in ("uniform", "trap", "elastic", "string")
        return self._steady(self.coordinates) if steady else ()

    @staticmethod
    def _steady(count: int) -> tuple[str, ...]:
        return tuple(f"force {i + 1}" for i in range(count))

    def _along(self, number: int) -> list[str]:
        """What a wall does to the speed along it."""
        if self.coordinates < 2 or self.walls[number - 1].smooth:
            return []
        return [f"grip {number}" if self.spins else f"along {number}"]

    @property
    def springs(self) -> tuple[tuple[int, int], ...]:
        """Pairs of coordinates between which springs act."""
        every = tuple(combinations(range(self.coordinates), 2))
        return (self.ties or every) if self.coupled else ()

    @property
    def turns(self) -> tuple[str, ...]:
        """Names of the numbers by which it is turned: about one axis, or about each of space."""
        if not self.turning:
            return ()
        about = [f" {i + 1}" for i in range(3)] if self.coordinates == 3 else [""]
        return tuple(f"turning{axis}" for axis in about)

    @property
    def frictions(self) -> tuple[str, ...]:
        """Its frictions, each by itself."""
        return () if self.friction == "none" else tuple(self.friction.split("+"))

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of its terms, as the menu calls them."""
        kinds = {self.restoring, *self.frictions} - {"none"}
        kinds |= {"wall"} if self.walls else set()
        kinds |= {"input"} if self.inputs else set()
        kinds |= {"forcing"} if self.forced else set()
        kinds |= {"lift"} if self.lift_fades is not None else set()
        kinds |= {"turning"} if self.turning else set()
        kinds |= {"curve"} if self.curve is not None else set()
        return frozenset(kinds | ({"pair"} if self.coupled else set()))

    def rate(self, numbers: Numbers) -> Any:
        """The fastest rate of its motion, radians per second; 0 where nothing swings."""
        stiff = [abs(x) for name, x in numbers.items() if name.startswith(("stiff", "swing"))]
        stiff += [2 * abs(x) for name, x in numbers.items() if name.startswith("coupling")]
        stiff += [numbers[name] ** 2 for name in ("lift", *self.turns) if name in numbers]
        stiff += [numbers[FORCING[-1]] ** 2] if self.forced else []
        if self.restoring == "string":
            pull = np.linalg.norm([numbers[name] for name in self.forces], axis=0)
            stiff += [OVER_TOP * pull / np.maximum(abs(numbers["rest"]), np.finfo(float).tiny)]
        if self.curve is not None:
            pull = np.linalg.norm([numbers[name] for name in self.forces], axis=0)
            stiff += [pull * self.curve.sharpest]
        if self.restoring == "centre":
            stiff += [abs(self.power(numbers) * numbers["strength"]) / self.near(numbers)]
        return np.sqrt(np.maximum(sum(stiff), 0.0))

    @staticmethod
    def power(numbers: Numbers) -> Any:
        """Of the distance, by which a fixed place pushes less; its number counts from Coulomb's."""
        return COULOMB + numbers["steeper"]

    @property
    def _place(self) -> tuple[str, ...]:
        """Names of the fixed place's coordinates."""
        here = self.restoring in ("elastic", "string")
        count = self.coordinates if here else len(self.turned_at)
        return tuple(f"centre {i + 1}" for i in range(count))

    def centre(self, numbers: Mapping[str, tuple[float, float]]) -> np.ndarray:
        """The fixed place ``(d,)``, of numbers with their errors."""
        return np.array([numbers[name][0] for name in self._place])

    def near(self, numbers: Numbers) -> Any:
        """Distance of the fixed place from where it has its strength."""
        away = [numbers[x] - at for x, at in zip(self._place, self.turned_at, strict=True)]
        return np.maximum(np.linalg.norm(away, axis=0), np.finfo(float).tiny)

    def later(self, values: np.ndarray, seconds: float) -> np.ndarray:
        """Its numbers ``(m,)``, where time is counted from a later moment."""
        later, at = values.copy(), self.names.index
        if self.lift_fades is not None:
            later[at("lift")] *= np.exp(-self.lift_fades * seconds)
        if self.forced:
            one, two, rate = (at(name) for name in FORCING)
            c, s = np.cos(values[rate] * seconds), np.sin(values[rate] * seconds)
            later[one] = c * values[one] + s * values[two]
            later[two] = c * values[two] - s * values[one]
        return later
