"""A wall that one body strikes again and again, found by fitting the whole recording.

A bounce is over within a frame, which no term of the menu describes: its acceleration is no
smooth function of place and speed. Between bounces the flight is known in closed form, so all
frames are one fit of seven numbers or fewer.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.wall.flights import Wall
from vidphys.diagnose.weak.regression import gram_inverse
from vidphys.statistics import NORMAL_95

FEW = 4  # bounces, from which a wall is believed
SHARES = (0.25, 0.5, 0.75, 1.0)  # of a recording, over which the fit grows
RATES = (0.6, 0.8, 1.0, 1.4)  # first guesses of half swings between bounces
SHARP = 0.4  # of the hardest bounce's change of speed: as hard are the others that are counted
FIRST = 4  # bounces whose distance in time tells the scale of the flights
CLOSE = 0.1  # of the path's spread: a wall is believed if the fit leaves less
ROBUST = 0.02  # of the spread: larger residuals count by their size, not its square
NAMES = tuple(field.name for field in fields(Wall))
MAY_VANISH = ("stiffness", "rate")  # numbers whose terms the scene may lack


@dataclass(frozen=True)
class WallFit:
    """A wall with how well it fits one body's recording.

    Args:
        wall: its numbers.
        errors: their standard errors, by name; infinite of a number that the scene does without.
        axis, sign: the coordinate, and which way along it the wall lies.
        beside: the other coordinates as quadratics, of ``s`` for a body on a string or a rail,
            of time for one that flies.
        bound: whether they are of ``s``.
        left: root mean square of what the fit leaves, in the unit of the positions.
        count: bounces.
    """

    wall: Wall
    errors: dict[str, float]
    axis: int
    sign: float
    beside: dict[int, np.ndarray]
    bound: bool
    left: float
    count: int

    def positions(
        self, times: np.ndarray, wall: Wall | None = None, begin: float = 0.0
    ) -> np.ndarray:
        """Places ``(t, 1, d)``, perhaps of a changed wall.

        Args:
            times: seconds since ``begin``, increasing.
            wall: in place of the fitted one.
            begin: seconds from the first frame to the wall's own start.
        """
        return self.place((wall or self.wall).path(times), begin + times)[:, None]

    def place(self, s: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Coordinates ``(..., d)`` of places ``(...)`` at seconds since the first frame."""
        out = np.zeros((*np.shape(s), 1 + len(self.beside)))
        out[..., self.axis] = self.sign * s
        for other, quadratic in self.beside.items():
            out[..., other] = np.polyval(quadratic, s if self.bound else times)
        return out


def find_wall(motion: Motion) -> WallFit | None:
    """The wall that a single body strikes, if that explains its recording.

    Args:
        motion: one body in one clip.
    """
    if motion.clips != 1 or motion.bodies != 1:
        return None
    seen = motion.seen[0, :, 0]
    path, times = motion.positions[0, seen, 0], motion.times[0, seen] - motion.times[0, 0]
    # A bounce is the sharpest turn of the path, and away from the wall.
    turns = np.diff(path, 2, axis=0)
    axis = int(np.abs(turns).max(0).argmax())
    sign = -float(np.sign((turns[:, axis] ** 3).sum()))
    s = sign * path[:, axis]
    wall, errors = _fitted(times, s)
    left, count = float((wall.path(times) - s).std()), wall.bounces(times[-1])
    named = dict(zip(NAMES, errors.tolist(), strict=True))
    lossy = 0 < wall.restitution <= 1 + NORMAL_95 * named["restitution"]
    if count < FEW or left > CLOSE * s.std() or not lossy:
        return None
    wall = replace(wall, restitution=min(wall.restitution, 1.0))
    others = [k for k in range(path.shape[1]) if k != axis]
    beside = [{k: np.polyfit(x, path[:, k], 2) for k in others} for x in (s, times)]
    off = [
        sum(float(((np.polyval(p, x) - path[:, k]) ** 2).sum()) for k, p in some.items())
        for x, some in zip((s, times), beside, strict=True)
    ]
    bound = off[0] <= off[1]
    return WallFit(wall, named, axis, sign, beside[0 if bound else 1], bound, left, count)


def _fitted(times: np.ndarray, s: np.ndarray) -> tuple[Wall, np.ndarray]:
    """Least squares over ever longer beginnings of the recording, and the numbers' errors.

    Of the terms that a scene may lack, those are left out that do not pay for themselves.
    """
    guesses, scale = _guesses(times, s)
    for share in SHARES:
        part = slice(0, max(len(NAMES) + 1, int(share * len(times))))
        best = min((_fit(times[part], s[part], g, scale) for g in guesses), key=lambda f: f.cost)
        guesses = [best.wall]
    for name in MAY_VANISH:
        held = np.where(np.array(NAMES) == name, 0.0, best.scale)
        without = _fit(times, s, replace(best.wall, **{name: 0.0}), held)
        if without.price(len(s)) < best.price(len(s)):
            best = without
    return best.wall, best.errors(len(s))


def _guesses(times: np.ndarray, s: np.ndarray) -> tuple[list[Wall], np.ndarray]:
    """Where fits begin, and the size of a change of each number: traps, and a uniform field."""
    spread, high = float(s.std()), float(np.quantile(s, 0.98))
    between = _between_bounces(times, s)
    swing = np.pi / between
    rate, speed = 0.02 * swing, float(np.gradient(s, times)[0])
    fall = 8 * (high - float(s.min())) / between**2
    bare = Wall(high, 0.8, 0.0, 0.0, rate, float(s[0]), speed)
    traps = [replace(bare, stiffness=(x * swing) ** 2) for x in RATES]
    change = Wall(
        place=0.2 * spread,
        restitution=0.2,
        stiffness=0.2 * swing**2,
        pull=0.5 * spread * swing**2,
        rate=rate,
        start=0.2 * spread,
        speed=0.25 * spread * swing,
    )
    return [*traps, replace(bare, pull=fall)], change.values


def _between_bounces(times: np.ndarray, s: np.ndarray) -> float:
    """Usual seconds between the first bounces, which turn the path sharply; a guess."""
    turn = -np.diff(s, 2)
    hard = np.nonzero(turn > SHARP * turn.max())[0]
    first = hard[np.diff(hard, prepend=-3) > 2]  # a bounce between frames turns two of them
    apart = np.diff(times[first[: FIRST + 1]])
    return float(np.median(apart)) if len(apart) else float(times[-1]) / FEW


@dataclass(frozen=True)
class _Fit:
    wall: Wall
    found: OptimizeResult
    scale: np.ndarray

    @property
    def cost(self) -> float:
        return float(self.found.cost)

    @property
    def free(self) -> np.ndarray:
        return np.nonzero(self.scale)[0]

    def price(self, frames: int) -> float:
        """Schwarz's criterion: the smaller the better."""
        return float(frames * np.log(2 * self.cost / frames) + len(self.free) * np.log(frames))

    def errors(self, frames: int) -> np.ndarray:
        """Standard errors of all numbers; infinite where one was held."""
        variance = float((self.found.fun**2).sum()) / max(frames - len(self.free), 1)
        covariance = variance * gram_inverse(self.found.jac.T @ self.found.jac)
        out = np.full(len(NAMES), np.inf)
        out[self.free] = self.scale[self.free] * np.sqrt(np.diag(covariance))
        return out


def _fit(times: np.ndarray, s: np.ndarray, guess: Wall, scale: np.ndarray) -> _Fit:
    """Least squares from a guess; numbers without a scale are held."""
    begin, free, spread = guess.values, np.nonzero(scale)[0], s.std()

    def wall(change: np.ndarray) -> Wall:
        values = begin.copy()
        values[free] += scale[free] * change
        return Wall(*values.tolist())

    def left(change: np.ndarray) -> np.ndarray:
        return (wall(change).path(times) - s) / spread

    with np.errstate(over="ignore", invalid="ignore"):  # of steps that are then taken back
        found = least_squares(left, np.zeros(len(free)), loss="soft_l1", f_scale=ROBUST)
    return _Fit(wall(found.x), found, scale)
