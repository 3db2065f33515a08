"""A law of bodies that each go on by themselves until they meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.kernels.colliding import rolled
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.terms import RATES
from vidphys.diagnose.recordings.inputs import Signal


@dataclass(frozen=True)
class Contact:
    """Two bodies that may meet.

    Args:
        one, two: their numbers.
        side: on a line, the sign of the second's place as the first sees it.
    """

    one: int
    two: int
    side: float = 1.0


@dataclass(frozen=True)
class Colliding(Law):
    """Bodies of the same number of coordinates each, and contacts between them.

    Momentum is kept in a collision, whatever is lost of the speed. A field is common to all bodies;
    each has a friction of its own.

    Args:
        contacts: of the pairs that meet.
        rubs: whether a collision takes of the speed across the line of centres too; spins are not
            seen, so it is one share of all collisions.
        bouncing: the body that bounces off each of the walls, whose normals are of its coordinates.
    """

    contacts: tuple[Contact, ...] = (Contact(0, 1),)
    rubs: bool = False
    bouncing: tuple[int, ...] = ()

    @property
    def bodies(self) -> int:
        """How many meet."""
        return 1 + max(max(c.one, c.two) for c in self.contacts)

    @property
    def space(self) -> int:
        """Coordinates of each."""
        return self.coordinates // self.bodies

    @property
    def forces(self) -> tuple[str, ...]:
        """The same for each coordinate of space: a field is common to all bodies."""
        return self._steady(self.space) if self.restoring == "uniform" else ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        return (
            *self.forces,
            *(f"{name} {b + 1}" for name in self.frictions for b in range(self.bodies)),
            *(f"mass {b + 1}" for b in range(1, self.bodies)),
            *(f"reach {i + 1}" for i in range(len(self.contacts))),
            "restitution",
            *(("rub",) if self.rubs else ()),
            *(name for i in range(len(self.walls)) for name in self._of_wall(i + 1)),
            *(view.NAMES if self.pictured else ()),
        )

    @property
    def kinds(self) -> frozenset[str]:
        return super().kinds | {"collision"}

    def _of_wall(self, number: int) -> list[str]:
        along = [f"along {number}"] if self.space > 1 else []
        return [f"wall {number}", f"restitution {number}", *along]

    def masses(self, numbers: Mapping[str, float]) -> np.ndarray:
        """Of all bodies over the first one's."""
        return np.array([1.0, *(numbers[f"mass {b + 1}"] for b in range(1, self.bodies))])

    def _rolled(
        self, values: np.ndarray, starts: np.ndarray, times: np.ndarray, inputs: Signal | None
    ) -> np.ndarray:
        each = zip(values, starts, strict=True)
        return np.stack([self._one_rolled(numbers, start, times) for numbers, start in each])

    def _one_rolled(self, values: np.ndarray, start: np.ndarray, times: np.ndarray) -> np.ndarray:
        known = dict(zip(self.names, values.tolist(), strict=True))
        n, d = self.bodies, self.space
        force = np.array([known.get(f"force {i + 1}", 0.0) for i in range(d)])
        friction = [[known.get(f"{name} {b + 1}", 0.0) for name in RATES] for b in range(n)]
        contacts = [
            [c.one, c.two, known[f"reach {i + 1}"], c.side] for i, c in enumerate(self.contacts)
        ]
        walls = [
            [body, *wall.normal, *(known[name] for name in self._of_wall(i)), *([1.0] * (d == 1))]
            for i, (body, wall) in enumerate(zip(self.bouncing, self.walls, strict=True), 1)
        ]
        out = rolled(
            times,
            start.reshape(2, n, d),
            force,
            np.array(friction),
            self.masses(known),
            np.array(contacts),
            known["restitution"],
            known.get("rub", 0.0),
            np.array(walls).reshape(-1, d + 4),
        )
        return out.reshape(len(times), 2, n * d)
