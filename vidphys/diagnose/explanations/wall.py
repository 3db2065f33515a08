"""A motion explained by a wall that its one body strikes again and again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics import terms
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.forecast import SAMPLES, State, Validation, beside_simple
from vidphys.diagnose.explanations.specification import PORTS, as_specification
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.wall.fit import WallFit, find_wall
from vidphys.statistics import NORMAL_95

OF_THE_SCENE = ("restitution", "stiffness", "pull", "rate")  # a wall's numbers beside its place


@dataclass(frozen=True)
class ByWall(Explanation):
    """A wall's fit to a recording before ``end``.

    Args:
        fit: the wall and the swing beside it.
        motion: the whole recording.
        end: first frame that nothing was fitted to.
    """

    fit: WallFit
    motion: Motion
    end: int

    @classmethod
    def of(cls, motion: Motion, end: int) -> ByWall | None:
        """The wall that explains the recording before ``end``, if one does."""
        fit = find_wall(motion.cut(0, end))
        return None if fit is None else cls(fit, motion, end)

    @property
    def times(self) -> np.ndarray:
        """Of the frames, seconds since the first."""
        return self.motion.times[0] - self.motion.times[0, 0]

    @property
    def kinds(self) -> list[str]:
        wall = self.fit.wall
        held = ["trap" if wall.stiffness else "uniform"]
        return sorted([*held, *(["linear"] if wall.rate else []), "wall"])

    @property
    def fastest(self) -> float:
        """Of the swing between bounces."""
        return float(np.sqrt(max(self.fit.wall.stiffness, 0.0)))

    def lines(self) -> list[str]:
        wall = self.fit.wall
        axis = "xyz"[self.fit.axis]
        between = [self._number("stiffness" if wall.stiffness else "pull", ".4g")]
        if wall.rate:
            between.append(f"{self._number('rate', '.2g', 'friction')} per second")
        return [
            f"The motion shows a wall: the body moves along {axis} and strikes {axis} = "
            f"{self.fit.sign * wall.place:.4g} {self.fit.count} times, each time keeping "
            f"{self._number('restitution', '.3g', '')} of its speed; "
            f"between, {' and '.join(between)} (95 %). The fit is off by {self.fit.left:.2g}."
        ]

    def _number(self, name: str, form: str, said: str | None = None) -> str:
        """A number with its interval."""
        value = f"{getattr(self.fit.wall, name):{form}}"
        interval = NORMAL_95 * self.fit.errors[name]
        return f"{name if said is None else said} {value} ± {interval:.1g}".strip()

    def data(self) -> dict[str, Any]:
        """The place as recorded, the pull positive towards the wall."""
        wall, errors = self.fit.wall, self.fit.errors
        told = {
            "axis": "xyz"[self.fit.axis],
            "place": self.fit.sign * wall.place,
            **{name: getattr(wall, name) for name in OF_THE_SCENE},
            "errors": {k: errors[k] for k in ("place", *OF_THE_SCENE) if np.isfinite(errors[k])},
            "bounces": self.fit.count,
        }
        return {"wall": told}

    def numbers(self) -> dict[str, float]:
        return {"wall_restitution": self.fit.wall.restitution}

    def forecast(self) -> Validation:
        """The simple forecasts begin at the model's last fitted frames."""
        end, h = self.end, self.motion.interval
        path = self.fit.positions(self.times)
        v = (path[end - 1] - path[end - 2]) / h
        a = (path[end - 1] - 2 * path[end - 2] + path[end - 3]) / h**2
        time = float(self.motion.times[0, end - 1])
        start = State(time, path[end - 1], v, self.motion.mass[0])
        return beside_simple(path[end:], self.motion.cut(end), start, a)

    def changed(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        begin, last = self.times[self.end - 1], self.times[-1]
        later = self.fit.wall.later(float(begin))
        since = np.linspace(0, last - begin + 0.3 * begin, SAMPLES)
        laws = {"no friction, no loss at the wall": replace(later, rate=0.0, restitution=1.0)}
        if later.stiffness:
            half = replace(later, stiffness=2 * later.stiffness, pull=2 * later.pull)
            laws["half the length"] = half
        else:
            laws["twice the field"] = replace(later, pull=2 * later.pull)
        when = self.motion.times[0, self.end - 1] + since
        return {
            name: (when, self.fit.positions(since, law, float(begin))) for name, law in laws.items()
        }

    def specification(self) -> dict[str, Any]:
        """The scene: a trap or a field, perhaps friction, and the wall, with the fit's numbers."""
        wall, errors = self.fit.wall, self.fit.errors
        trapped = bool(wall.stiffness)
        origin = self.fit.place(np.asarray(wall.rest if trapped else wall.place), np.zeros(()))
        normal = [0.0] * len(origin)
        normal[self.fit.axis] = self.fit.sign
        field = terms.Trap(wall.stiffness) if trapped else terms.Uniform()
        free = terms.Hamiltonian(
            potentials=(terms.NoPotential(), field), ports=(PORTS["linear"],) if wall.rate else ()
        )
        place = wall.place - wall.rest if trapped else 0.0
        term = terms.Walled(free, place, wall.restitution, tuple(normal))
        named = {f"wall: {name}": name for name in ("place", "restitution")}
        named |= {"trap: stiffness": "stiffness"} if trapped else {}
        named |= {"linear: rate": "rate"} if wall.rate else {}
        numbers = {key: (getattr(wall, name), errors[name]) for key, name in named.items()}
        if not trapped:
            numbers[f"uniform: {'xyz'[self.fit.axis]}"] = self.fit.sign * wall.pull, errors["pull"]
        return as_specification(term, 1, origin.tolist(), numbers, True, self.motion.interval)
