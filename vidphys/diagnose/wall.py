"""A wall that one body strikes again and again: a trap's damped swing between losing bounces.

A bounce is over within a frame, which no term of the menu describes: its acceleration is no
smooth function of place and speed. Between bounces the swing is known in closed form, so the
whole recording is one fit of seven numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.optimize import OptimizeResult, brentq, least_squares

from vidphys.diagnose.motion import Motion
from vidphys.diagnose.regression import gram_inverse

FEW = 6  # bounces, from which a wall is believed
SHARES = (0.25, 0.5, 0.75, 1.0)  # of a recording, over which the fit grows
RATES = (6.0, 9.0, 12.0, 16.0)  # first guesses of the stiffness, over the spread of s squared
TRIES = 48  # places in a period at which the next bounce is looked for
MOST = 400  # bounces, after which the body lies at the wall
SHORTEST = 1e-4  # seconds of a flight, below which it lies there too
CLOSE = 0.1  # of the path's spread: a wall is believed if the fit leaves less
ROBUST = 0.02  # of the spread: larger residuals count by their size, not its square


@dataclass(frozen=True)
class Wall:
    """A swing beside a wall, in one coordinate ``s`` that grows towards the wall.

    Args:
        place: of the wall.
        restitution: speed after a bounce over that before it.
        stiffness: of the trap, per second squared.
        rest: where the trap pulls to.
        rate: of linear friction, per second.
        start, speed: place and speed at the first frame.
    """

    place: float
    restitution: float
    stiffness: float
    rest: float
    rate: float
    start: float
    speed: float

    @property
    def values(self) -> np.ndarray:
        """The numbers, in their order."""
        return np.array([getattr(self, name) for name in NAMES])

    @classmethod
    def of(cls, values: np.ndarray) -> Wall:
        """From its numbers, in their order."""
        return cls(*(float(value) for value in values))

    def flights(self, seconds: float) -> Iterator[tuple[float, float, _Flight]]:
        """Begin, end and course of each flight until then; none where the body lies at the wall."""
        begin, s, v = 0.0, self.start, self.speed
        for _ in range(MOST):
            flight = _Flight(self, s, v)
            lasts = flight.next_bounce()
            yield begin, begin + lasts, flight
            if begin + lasts > seconds or lasts < SHORTEST:
                return
            v = -self.restitution * float(flight.at(np.array([lasts]))[1][0])
            begin, s = begin + lasts, self.place

    def path(self, times: np.ndarray) -> np.ndarray:
        """Places at increasing times since the first frame, seconds."""
        out = np.full(len(times), self.place)
        for begin, end, flight in self.flights(float(times[-1])):
            here = (times >= begin) & (times <= end)
            out[here] = flight.at(times[here] - begin)[0]
        return out

    def bounces(self, seconds: float) -> int:
        """How many there are in so long."""
        return sum(int(end <= seconds) for _, end, _ in self.flights(seconds))

    def later(self, seconds: float) -> Wall:
        """The same, begun so much later."""
        place, speed = np.array([self.place]), np.zeros(1)
        for begin, end, flight in self.flights(seconds):
            if begin <= seconds <= end:
                place, speed = flight.at(np.array([seconds - begin]))
        return replace(self, start=float(place[0]), speed=float(speed[0]))


NAMES = tuple(field.name for field in fields(Wall))


@dataclass(frozen=True)
class _Flight:
    """A damped swing from one bounce to the next."""

    wall: Wall
    s: float
    v: float

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places and speeds, ``t`` seconds after its start."""
        half = 0.5 * self.wall.rate
        omega = np.sqrt(max(self.wall.stiffness - half**2, 1e-6))
        a = self.s - self.wall.rest
        b = (self.v + half * a) / omega
        fade, c, s = np.exp(-half * t), np.cos(omega * t), np.sin(omega * t)
        place = self.wall.rest + fade * (a * c + b * s)
        return place, fade * ((b * omega - half * a) * c - (a * omega + half * b) * s)

    def next_bounce(self) -> float:
        """Seconds until the wall is reached; infinite if it is not within a period."""
        period = 2 * np.pi / np.sqrt(max(self.wall.stiffness, 1e-6))
        t = np.linspace(0, period, TRIES + 1)[1:]
        beyond = self.at(t)[0] > self.wall.place
        if not beyond.any():
            return np.inf
        first = int(beyond.argmax())
        low = t[first - 1] if first else 0.5 * t[0]
        if self.at(np.array([low]))[0][0] > self.wall.place:
            return float(low)
        return float(
            brentq(lambda x: self.at(np.array([x]))[0][0] - self.wall.place, low, t[first])
        )


@dataclass(frozen=True)
class WallFit:
    """A wall with how well it fits one body's recording.

    Args:
        wall: its numbers.
        errors: their standard errors, by name.
        axis, sign: the coordinate, and which way along it the wall lies.
        arc: the other coordinates as quadratics of ``s``, for a body on a string or a rail.
        left: root mean square of what the fit leaves, in the unit of the positions.
        count: bounces.
    """

    wall: Wall
    errors: dict[str, float]
    axis: int
    sign: float
    arc: dict[int, np.ndarray]
    left: float
    count: int

    def positions(self, times: np.ndarray, wall: Wall | None = None) -> np.ndarray:
        """Places ``(t, 1, d)`` at seconds since the first frame, perhaps of a changed wall."""
        return self.place((wall or self.wall).path(times))[:, None]

    def place(self, s: np.ndarray) -> np.ndarray:
        """Coordinates ``(..., d)`` of places ``(...)`` along the path."""
        out = np.zeros((*np.shape(s), 1 + len(self.arc)))
        out[..., self.axis] = self.sign * s
        for other, quadratic in self.arc.items():
            out[..., other] = np.polyval(quadratic, s)
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
    axis = int(path.std(0).argmax())
    s = path[:, axis]
    # The wall is where the path is cut off: the nearer end of its range to the middle.
    sign = 1.0 if s.max() - np.median(s) < np.median(s) - s.min() else -1.0
    s = sign * s
    wall, errors = _fitted(times, s)
    left, count = float((wall.path(times) - s).std()), wall.bounces(times[-1])
    lossy = 0 < wall.restitution <= 1
    if count < FEW or left > CLOSE * s.std() or not lossy:
        return None
    others = [k for k in range(path.shape[1]) if k != axis]
    arc = {k: np.polyfit(s, path[:, k], 2) for k in others}
    return WallFit(
        wall, dict(zip(NAMES, errors.tolist(), strict=True)), axis, sign, arc, left, count
    )


def _fitted(times: np.ndarray, s: np.ndarray) -> tuple[Wall, np.ndarray]:
    """Least squares over ever longer beginnings of the recording, and the numbers' errors."""
    spread, high = float(s.std()), float(np.quantile(s, 0.98))
    speed = float(np.gradient(s, times)[0])
    guesses = [Wall(high, 0.8, rate, high, 0.1, float(s[0]), speed) for rate in RATES]
    scale = np.array([0.2 * spread, 0.2, 3.0, 0.5 * spread, 0.1, 0.2 * spread, spread])
    for share in SHARES:
        part = slice(0, max(len(NAMES) + 1, int(share * len(times))))
        fits = [_fit(times[part], s[part], guess, scale) for guess in guesses]
        best = min(fits, key=lambda fit: fit[1].cost)
        guesses = [best[0]]
    wall, found = best
    freedom = max(len(s) - len(NAMES), 1)
    variance = float((found.fun**2).sum()) / freedom
    covariance = variance * gram_inverse(found.jac.T @ found.jac)
    return wall, scale * np.sqrt(np.diag(covariance))


def _fit(
    times: np.ndarray, s: np.ndarray, guess: Wall, scale: np.ndarray
) -> tuple[Wall, OptimizeResult]:
    begin = guess.values

    def left(change: np.ndarray) -> np.ndarray:
        return Wall.of(begin + scale * change).path(times) - s

    found = least_squares(left, np.zeros(len(NAMES)), loss="soft_l1", f_scale=ROBUST * s.std())
    return Wall.of(begin + scale * found.x), found
