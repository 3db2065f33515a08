"""A body beside a wall, in closed form: damped flights in a trap or a field, and losing bounces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import brentq

TRIES = 48  # places at which the next bounce is looked for
BEYOND = 1.05  # of the time in which it must come, so that rounding does not hide it
MOST = 400  # bounces, after which the body lies at the wall
SHORTEST = 1e-5  # of the recording, of a flight, below which it lies there too
WEAK, STEEP = 1.0, 20.0  # square of an angle, and friction's exponent, up to which nodes suffice
NODES = 32  # of Gauss and Legendre
SMALL = 1e-6  # of the square of an angle, below which its cosine is a parabola


@dataclass(frozen=True)
class Wall:
    """A flight beside a wall, in one coordinate ``s`` that grows towards the wall.

    Args:
        place: of the wall.
        restitution: speed after a bounce over that before it.
        stiffness: of the trap, per second squared; 0 in a uniform field.
        pull: acceleration at the wall, towards it.
        rate: of linear friction, per second.
        start, speed: place and speed at the first frame.
    """

    place: float
    restitution: float
    stiffness: float
    pull: float
    rate: float
    start: float
    speed: float

    @property
    def rest(self) -> float:
        """Where the trap pulls to."""
        return self.place + self.pull / self.stiffness

    @property
    def values(self) -> np.ndarray:
        """The numbers, in their order."""
        return np.array(astuple(self))

    def flights(self, seconds: float) -> Iterator[tuple[float, float, _Flight]]:
        """Begin, end and course of each flight until then; none where the body lies at the wall."""
        begin, s, v = 0.0, self.start, self.speed
        for _ in range(MOST):
            flight = _Flight(self, s, v)
            lasts = flight.next_bounce()
            yield begin, begin + lasts, flight
            if begin + lasts > seconds or lasts < SHORTEST * seconds:
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


@dataclass(frozen=True)
class _Flight:
    """From one bounce to the next."""

    wall: Wall
    s: float
    v: float

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places and speeds, ``t`` seconds after its start."""
        wall, away = self.wall, self.s - self.wall.place
        half, kick = 0.5 * wall.rate, self._kick(t)
        swing = np.exp(-half * t) * np.cos(self.omega * t).real
        still = swing + half * kick
        place = away * still + self.v * kick + wall.pull * self._driven(t, still)
        speed = (wall.pull - wall.stiffness * away) * kick + self.v * (swing - half * kick)
        return wall.place + place, speed

    @cached_property
    def omega(self) -> complex:
        """Radians per second, imaginary where friction lets nothing swing."""
        return complex(np.sqrt(complex(self.wall.stiffness - 0.25 * self.wall.rate**2)))

    def _kick(self, t: np.ndarray) -> np.ndarray:
        """Displacement by a unit of speed at first."""
        return np.exp(-0.5 * self.wall.rate * t) * t * np.sinc(self.omega * t / np.pi).real

    def _driven(self, t: np.ndarray, still: np.ndarray) -> np.ndarray:
        """Displacement by a unit of constant acceleration; ``still``: what is left of a place.

        By weak terms it is the integral of what a unit of speed does; the difference from what is
        left would be rounding errors.
        """
        stiffness, rate = self.wall.stiffness, self.wall.rate
        longest = float(t.max(initial=0.0))
        weak = abs(stiffness) * longest**2 < WEAK and abs(rate) * longest < STEEP
        if weak:
            nodes, weights = np.polynomial.legendre.leggauss(NODES)
            return 0.5 * t * (self._kick(t[..., None] * 0.5 * (1 + nodes)) @ weights)
        if abs(stiffness) * longest**2 > SMALL:
            return (1 - still) / stiffness
        return (rate * t + np.expm1(-rate * t)) / rate**2

    def next_bounce(self) -> float:
        """Seconds until the wall is reached; infinite if it never is."""
        within = self._within()
        if not np.isfinite(within):
            return np.inf
        t = np.linspace(0, within, TRIES + 1)[1:]
        beyond = self.at(t)[0] > self.wall.place
        if not beyond.any():
            return np.inf
        first = int(beyond.argmax())
        low = t[first - 1] if first else 0.5 * t[0]
        if self._depth(low) > 0:
            return float(low)
        return float(brentq(self._depth, low, t[first]))

    def _depth(self, t: float) -> float:
        return float(self.at(np.array([t]))[0][0]) - self.wall.place

    def _within(self) -> float:
        """Seconds in which the wall is reached if it ever is: a period, or that of a fall."""
        wall, within = self.wall, np.inf
        if self.omega.real > 0:
            within = 2 * np.pi / self.omega.real
        if wall.pull > 0:
            deep = wall.place - self.s + 0.5 * self.v**2 / wall.pull
            fall = abs(self.v) / wall.pull + np.sqrt(2 * max(deep, 0.0) / wall.pull)
            within = min(within, fall + max(wall.rate, 0.0) * max(deep, 0.0) / wall.pull)
        return BEYOND * float(within)
