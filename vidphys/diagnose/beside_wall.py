"""What is said of a body that a wall turns back: words, numbers, forecasts and its scene."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from dynamics.terms import HamiltonianTerms
from vidphys.diagnose.forecast import State, Validation, beside_simple
from vidphys.diagnose.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.specification import PORTS, as_specification
from vidphys.diagnose.wall import WallFit, find_wall
from vidphys.statistics import NORMAL_95

SAMPLES = 600  # of a changed law
KINDS = ("linear", "trap", "wall")  # of terms, that every such scene has


@dataclass(frozen=True)
class BesideWall:
    """A wall's fit to the part of a recording before ``end``, and what follows from it.

    Args:
        fit: the wall and the swing beside it.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
    """

    fit: WallFit
    motion: Motion
    end: int

    @classmethod
    def of(cls, motion: Motion, end: int) -> BesideWall | None:
        """The wall that explains the recording before ``end``, if one does."""
        fit = find_wall(motion.cut(0, end))
        return None if fit is None else cls(fit, motion, end)

    @property
    def times(self) -> np.ndarray:
        """Of the frames, seconds since the first."""
        return self.motion.times[0] - self.motion.times[0, 0]

    def line(self) -> str:
        """For a person."""
        wall, errors = self.fit.wall, self.fit.errors
        axis = "xyz"[self.fit.axis]
        return (
            f"The motion shows a wall: the body swings along {axis} and strikes {axis} = "
            f"{self.fit.sign * wall.place:.4g} {self.fit.count} times, each time keeping "
            f"{wall.restitution:.3g} ± {NORMAL_95 * errors['restitution']:.1g} of its speed; "
            f"between, stiffness {wall.stiffness:.4g} ± {NORMAL_95 * errors['stiffness']:.1g} and "
            f"friction {wall.rate:.2g} ± {NORMAL_95 * errors['rate']:.1g} per second (95 %). The "
            f"fit is off by {self.fit.left:.2g}."
        )

    def data(self) -> dict[str, Any]:
        """As JSON."""
        return {**asdict(self.fit.wall), "errors": self.fit.errors, "bounces": self.fit.count}

    def forecast(self) -> Validation | None:
        """The tail beside simple forecasts; ``None`` where there is none to speak of.

        The simple ones begin at the model's last fitted frames.
        """
        end, h = self.end, self.motion.interval
        if end >= len(self.times) - LEAST_FRAMES:
            return None
        path = self.fit.positions(self.times)
        v = (path[end - 1] - path[end - 2]) / h
        a = (path[end - 1] - 2 * path[end - 2] + path[end - 3]) / h**2
        time = float(self.motion.times[0, end - 1])
        start = State(time, path[end - 1], v, self.motion.mass[0])
        return beside_simple(path[end:], self.motion.cut(end), start, a)

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Times and positions after ``end`` under laws that were never recorded."""
        begin, last = self.times[self.end - 1], self.times[-1]
        later = self.fit.wall.later(float(begin))
        since = np.linspace(0, last - begin + 0.3 * begin, SAMPLES)
        laws = {
            "no friction, no loss at the wall": replace(later, rate=0.0, restitution=1.0),
            "half the length": replace(later, stiffness=2 * later.stiffness),
        }
        when = self.motion.times[0, self.end - 1] + since
        return {name: (when, self.fit.positions(since, law)) for name, law in laws.items()}

    def specification(self) -> dict[str, Any]:
        """The scene: a trap, its friction and the wall, all of which the fit has numbers for."""
        wall, errors = self.fit.wall, self.fit.errors
        origin = self.fit.place(np.asarray(wall.rest)).tolist()
        normal = [0.0] * len(origin)
        normal[self.fit.axis] = self.fit.sign
        terms = HamiltonianTerms(
            potential="none",
            trap=wall.stiffness,
            ports=(PORTS["linear"],),
            wall=(wall.place - wall.rest, wall.restitution, *normal),
        )
        named = {"trap: stiffness": "stiffness", "linear: rate": "rate"}
        named |= {f"wall: {name}": name for name in ("place", "restitution")}
        numbers = {key: (getattr(wall, name), errors[name]) for key, name in named.items()}
        return as_specification(terms, 1, origin, numbers, True, self.motion.interval)
