"""A law of motion, rolled from its numbers: of one fit, or of many at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.mechanisms.kernels.motion import rolled
from vidphys.diagnose.mechanisms.kernels.sliding import slid
from vidphys.diagnose.mechanisms.kernels.string import swung
from vidphys.diagnose.mechanisms.terms import FORCING, RATES, Numbers, Terms
from vidphys.diagnose.recordings.inputs import Signal

FINE = 0.15  # radians of the fastest motion that one step turns at most
MOST_POINTS = 100_000  # through which a sinusoid is drawn
STRAIGHT = 0.02  # radians of a sinusoid, that are taken for straight
NEAREST = 0.02  # of its first distance, that a body comes to the camera at most
STEPS = (1, 64)  # in a frame, at least and at most


@dataclass(frozen=True)
class Law(Terms):
    """Accelerations of k coordinates, and the motion that they make."""

    def roll(
        self,
        values: np.ndarray,
        start: np.ndarray,
        times: np.ndarray,
        inputs: Signal | None = None,
    ) -> np.ndarray:
        """Coordinates and rates ``(…, t, 2, k)`` from starts ``(…, 2, k)`` at the first time.

        Args:
            values: its numbers, of each start ``(…, m)``.
            inputs: that are known, by the same times.
        """
        starts = start.reshape(-1, 2, self.coordinates)
        numbers = values.reshape(len(starts), len(self.names))
        with np.errstate(all="ignore"):  # of trial numbers that fly apart: the fit takes them back
            out = self._rolled(numbers, starts, times, inputs)
        return out.reshape(*values.shape[:-1], *out.shape[1:])

    def _rolled(
        self, values: np.ndarray, starts: np.ndarray, times: np.ndarray, inputs: Signal | None
    ) -> np.ndarray:
        """The same of numbers ``(b, m)`` and starts ``(b, 2, k)``, ``(b, t, 2, k)``."""
        numbers = dict(zip(self.names, values.T, strict=True))
        # The usual interval: a gap is stepped over as finely as frames in a row; and all of them
        # as finely as the fastest, because a derivative by two of them must not tell of steps.
        gaps, middle = times[1:] - times[:-1], (len(times) - 1) // 2
        gaps.partition(middle)
        interval = float(gaps[middle])
        steps = np.fmax.reduce(np.ravel(np.ceil(self.rate(numbers) * interval / FINE)))
        most = interval / float(np.fmin(np.fmax(steps, STEPS[0]), STEPS[1])) * (1 + 1e-9)
        if self.curve is not None:
            return self._slid(numbers, starts, times, most)
        if self.restoring == "string":
            return self._swung(numbers, starts, times, most)
        count = len(values)
        force, stiffness, swing, friction = self._forces(numbers, count)
        out = rolled(
            times,
            starts,
            force,
            stiffness,
            swing,
            friction,
            self._walls(numbers, count),
            most,
            apart=self.apart,
            rods=_rows(count, numbers.get("link", 0.0), numbers.get("inertia", 0.0)),
            pushed=self._pushed(numbers, inputs, times, most),
            centre=self._centre(numbers, count),
            hung=np.array(self.hung),
            lift=_rows(count, numbers.get("lift", 0.0), self.lift_fades or 0.0),
            turning=_rows(count, *(numbers[name] for name in self.turns)),
            spin=numbers["spin"] * np.linalg.norm(starts[:, 1], axis=-1) if self.spins else None,
        )
        if self.nears:
            nearer = 1 - numbers["nearing"][:, None] * (times - times[0])
            out[:, :, 0] /= np.maximum(nearer, NEAREST)[..., None]
        return out

    def _slid(
        self, numbers: Numbers, starts: np.ndarray, times: np.ndarray, most: float
    ) -> np.ndarray:
        """Lengths along the curve and their rates ``(b, t, 2, 1)``."""
        assert self.curve is not None
        table, spacing, count = self.curve.table, self.curve.spacing, len(starts)
        force = _rows(count, *(numbers.get(name, 0.0) for name in self._steady(2)))
        friction = _rows(count, *(numbers.get(name, 0.0) for name in RATES))
        each = zip(starts, force, friction, strict=True)
        return np.stack([slid(times, x, f, lost, table, spacing, most) for x, f, lost in each])

    def _swung(
        self, numbers: Numbers, starts: np.ndarray, times: np.ndarray, most: float
    ) -> np.ndarray:
        """Places of a weight on a string and their rates ``(b, t, 2, k)``."""
        count = len(starts)
        string = _rows(count, *(numbers[name] for name in self._place), numbers["rest"])
        force = _rows(count, *(numbers[name] for name in self.forces))
        rates = _rows(count, numbers.get("linear", 0.0))[:, 0]
        each = zip(starts, string, force, rates, strict=True)
        return np.stack([swung(times, x, at, f, float(rate), most) for x, at, f, rate in each])

    def _forces(self, numbers: Numbers, count: int) -> tuple[np.ndarray, ...]:
        """As the kernel takes so many: force, stiffness, swing and frictions."""
        k = self.coordinates
        force, stiffness, swing = (
            np.zeros((count, k)),
            np.zeros((count, k, k)),
            np.zeros((count, k)),
        )
        for i in range(k):
            own = f" {i + 1}" if self.apart and k > 1 else ""
            force[:, i] = numbers.get(f"force {i + 1}", 0.0)
            if self.restoring == "trap" and i not in self.loose:
                stiffness[:, i, i] = numbers[f"stiffness{own}"]
            swing[:, i] = numbers.get(f"swing{own}", 0.0)
        for pair in self.springs:
            for i, j in (pair, pair[::-1]):
                pull = numbers[f"coupling {i + 1}"] / (k - 1)
                stiffness[:, i, i] += pull
                stiffness[:, i, j] -= pull
        return force, stiffness, swing, _rows(count, *(numbers.get(name, 0.0) for name in RATES))

    def _pushed(
        self, numbers: Numbers, inputs: Signal | None, times: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Times ``(t,)``, and accelerations by what is known, or by a sinusoid, ``(b, t, k)``."""
        if self.forced:
            along, across, rate = (np.reshape(numbers[name], (-1, 1)) for name in FORCING)
            lasts = times[-1] - times[0]
            count = int(np.fmin(abs(rate).max() * lasts / STRAIGHT, MOST_POINTS)) + 2
            when = np.linspace(times[0], times[-1], count)
            wave = along * np.cos(rate * when) + across * np.sin(rate * when)
            # lines between points of a wave, and within each step, follow a smaller wave
            lines = (lasts / (count - 1), step)
            smaller = np.prod([np.sinc(rate * line / (2 * np.pi)) ** 2 for line in lines], axis=0)
            return when, (wave / smaller)[..., None]
        if not self.inputs or inputs is None:
            return None
        gains = np.array([numbers[f"gain {i + 1}"] for i in range(self.inputs)])
        return inputs.times, (inputs.values @ gains).T[..., None]

    def _centre(self, numbers: Numbers, count: int) -> np.ndarray:
        """As the kernel takes so many, ``(count, d + 4)``; empty where there is none."""
        if self.restoring not in ("centre", "elastic"):
            return _rows(count)
        place = [numbers[name] for name in self._place]
        if self.restoring == "elastic":
            stiffness = numbers["stiffness"]
            return _rows(count, *place, -stiffness, -1.0, 1.0, stiffness * numbers["rest"])
        return _rows(
            count, *place, numbers["strength"], self.power(numbers), self.near(numbers), 0.0
        )

    def _walls(self, numbers: Numbers, count: int) -> np.ndarray:
        """Of each its normal, place, restitution, and what a bounce leaves along it, as the kernel
        takes so many, ``(count, w, k + 3)``.
        """
        k = self.coordinates
        walls = np.ones((count, len(self.walls), k + 3))
        for number, wall in enumerate(self.walls, 1):
            row = walls[:, number - 1]
            row[:, :k] = wall.turned(numbers.get(f"turn {number}", 0.0))
            told = (f"wall {number}", f"restitution {number}", *self._along(number))
            for i, name in enumerate(told, k):
                row[:, i] = numbers[name]
        return walls


def _rows(count: int, *numbers: float | np.ndarray) -> np.ndarray:
    """Numbers ``(count,)``, or the same of all, side by side, ``(count, n)``."""
    rows = np.empty((count, len(numbers)))
    for i, number in enumerate(numbers):
        rows[:, i] = number
    return rows
