"""Motions on a bowl, on a string that goes slack, and, which no term has, in a bent trap."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from vidphys.experiments.filmed.laws.law import ACCURACY, GRAVITY, Law, integrate


def _bowl(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """A bead in gravity on ``y = depth |x / width|^power`` from rest; friction is of its speed."""
    depth, width, power, damping, begin = numbers

    def shape(x: float) -> tuple[float, float]:
        """Slope and bend of the curve."""
        away = abs(x) / width
        slope = np.sign(x) * depth * power / width * away ** (power - 1)
        return slope, depth * power * (power - 1) / width**2 * away ** (power - 2)

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        x, v = state
        slope, bend = shape(x)
        pull = -(slope * bend * v**2 + GRAVITY * slope) / (1 + slope**2)
        return np.array([v, pull - damping * v])

    x = integrate(rate, np.array([begin, 0.0]), times)[:, 0]
    return np.stack([x, depth * np.abs(x / width) ** power], -1)[:, None]


BOWL = Law(("depth", "width", "power", "damping", "begin"), _bowl)


def _trap(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """On a line, from rest, under ``-strength sgn(x) |x|^power``."""
    strength, power, damping, begin = numbers

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        x, v = state
        return np.array([v, -strength * np.sign(x) * abs(x) ** power - damping * v])

    return integrate(rate, np.array([begin, 0.0]), times)[:, None, :1]


BENT_TRAP = Law(("strength", "power", "damping", "begin"), _trap)


def _slack(numbers: np.ndarray, times: np.ndarray) -> np.ndarray:
    """A weight on a string, thrown from its lowest place, that falls freely where it is slack.

    The string takes what speed there is along it when it is taut again.
    """
    length, damping, speed = numbers
    out, begin = np.empty((len(times), 2)), 0.0
    place, v, taut = np.array([0.0, -length]), np.array([speed, 0.0]), True

    def rate(_: float, state: np.ndarray) -> np.ndarray:
        q, u = state[:2], state[2:]
        a = np.array([0.0, -GRAVITY]) - damping * u
        if taut:
            a = a - (a @ q + u @ u) / (q @ q) * q
        return np.concatenate([u, a])

    def lets_go(_: float, state: np.ndarray) -> float:
        q, u = state[:2], state[2:]
        return float(u @ u - GRAVITY * q[1])  # its pull, times the length

    def stretched(_: float, state: np.ndarray) -> float:
        return float(state[:2] @ state[:2] - length**2 * (1 + 1e-9))

    lets_go.terminal, lets_go.direction = True, -1  # type: ignore[attr-defined]
    stretched.terminal, stretched.direction = True, 1  # type: ignore[attr-defined]
    while begin < times[-1]:
        event = lets_go if taut else stretched
        found = solve_ivp(
            rate,
            (begin, float(times[-1])),
            np.concatenate([place, v]),
            "DOP853",
            dense_output=True,
            events=event,
            rtol=ACCURACY,
            atol=ACCURACY,
        )
        here = (times >= begin) & (times <= found.t[-1])
        out[here] = found.sol(times[here])[:2].T
        begin, place, v = float(found.t[-1]), found.y[:2, -1], found.y[2:, -1]
        if not taut:
            along = place / np.linalg.norm(place)
            place, v = length * along, v - (v @ along) * along
        taut = not taut
        if taut and v @ v < GRAVITY * place[1]:  # it cannot stay so
            taut = False
    return out[:, None]


SLACK = Law(("length", "damping", "speed"), _slack)
