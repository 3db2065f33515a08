"""Rolling a diagnosed scene on: past the end of the recording, and under a change of its law."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import solve_ivp

from vidphys.diagnose.inference.longer import LongFit
from vidphys.diagnose.inference.menu import EXTERNAL, FRICTION, Field
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

ACCURACY = 1e-8
EVALUATIONS, LEAST_EVALUATIONS = 1000, 20_000  # of the force: a moment, and in all
SAMPLES = 600  # of a changed law
GAIN = 0.8  # of the error of bodies that stay, below which a model foretells more than that


@dataclass(frozen=True)
class State:
    """Places and velocities ``(n, d)`` at a time in seconds, and the bodies' masses ``(n,)``."""

    time: float
    q: np.ndarray
    v: np.ndarray
    mass: np.ndarray


def last_state(look: LongFit) -> tuple[State, np.ndarray]:
    """The state at the end of the last window of the last clip, and its acceleration."""
    paths, windows = look.fitted.paths, look.windows
    time = float(windows.begin[-1] + windows.length[-1])
    state = State(time, paths.q[-1, -1], paths.v[-1, -1], windows.mass[-1])
    return state, paths.a[-1, -1]


def roll(structure: Structure, start: State, times: np.ndarray) -> np.ndarray:
    """Positions ``(t, n, d)`` at increasing times, from a state at or before the first.

    Raises:
        FloatingPointError: the integration failed, or needs steps far shorter than what was asked.
    """
    shape, left = start.q.shape, [max(LEAST_EVALUATIONS, EVALUATIONS * len(times))]

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        left[0] -= 1
        if left[0] < 0:
            raise FloatingPointError("roll: the terms need steps far shorter than a frame")
        q, v = state.reshape(2, 1, 1, *shape)
        field = Field(q, v, np.array([[t]]), start.mass[None], np.ones(1))
        return np.concatenate([v.ravel(), structure.accelerations(field).ravel()])

    first = np.concatenate([start.q.ravel(), start.v.ravel()])
    span = (start.time, float(times[-1]))
    size = np.abs(first).max() or 1.0
    solved = solve_ivp(
        slope, span, first, t_eval=times, rtol=ACCURACY, atol=ACCURACY * size, method="DOP853"
    )
    if not solved.success:
        raise FloatingPointError(f"roll: {solved.message}")
    return solved.y.T[:, : start.q.size].reshape(-1, *shape)


@dataclass(frozen=True)
class Validation:
    """A forecast of the tail that nothing was fitted to, against what needs no model.

    Args:
        times: of the tail, ``(t,)``.
        seen: positions there, ``(t, n, d)``; NaN where a body was not seen.
        forecasts: positions by name, ``model`` first.
        errors: root mean squared distance of each, in the unit of the positions.
        last: where each body was seen last before the tail, ``(n, d)``.
    """

    times: np.ndarray
    seen: np.ndarray
    forecasts: dict[str, np.ndarray]
    errors: dict[str, float]
    last: np.ndarray

    @property
    def gains(self) -> bool:
        """Whether the model is clearly nearer than bodies that stay where they were seen last."""
        return self.errors["model"] < GAIN * self.at_rest.errors["model"]

    @property
    def at_rest(self) -> Validation:
        """The same with bodies that stay where they were seen last for the model's."""
        path = np.broadcast_to(self.last, self.seen.shape)
        forecasts = {**self.forecasts, **dict.fromkeys(("model", "persistence"), path)}
        return replace(self, forecasts=forecasts, errors=_errors(forecasts, self.seen))

    @property
    def beats_all(self) -> bool:
        """Whether the model is nearer than every simple forecast."""
        return all(self.errors["model"] < e for name, e in self.errors.items() if name != "model")


def inner_ends(end: int, total: int) -> list[int]:
    """Frames that leave as large a share of the first ``end`` as that leaves of all, or half.

    None that come too early to show a force.
    """
    share = end * (total - end) // total
    ends = [end - max(share // part, LEAST_FRAMES) for part in (1, 2)]
    return [inner for inner in ends if inner >= LEAST_FRAMES]


def beside_simple(
    model: np.ndarray, motion: Motion, end: int, start: State, a: np.ndarray
) -> Validation:
    """A model's forecast beside persistence, constant velocity and constant acceleration.

    Args:
        model: positions in the tail of the last clip, ``(t, n, d)``.
        motion: the whole recording.
        end: where the tail begins, which nothing was fitted to.
        start: the model's last state before the tail, where the simple ones begin.
        a: the acceleration there, ``(n, d)``.
    """
    times, seen = motion.times[-1, end:], motion.positions[-1, end:]
    since = (times - start.time)[:, None, None]
    straight = start.q + start.v * since
    forecasts = {
        "model": model,
        "persistence": np.broadcast_to(start.q, seen.shape),
        "constant velocity": straight,
        "constant acceleration": straight + 0.5 * a * since**2,
    }
    last = last_seen(motion.positions[-1, :end], start.q)
    return Validation(times, seen, forecasts, _errors(forecasts, seen), last)


def last_seen(places: np.ndarray, unseen: np.ndarray) -> np.ndarray:
    """Where each body of ``(t, n, d)`` was seen last, or else the place that is given."""
    seen = np.isfinite(places).all(-1)
    frames = len(places) - 1 - seen[::-1].argmax(0)
    return np.where(seen.any(0)[:, None], places[frames, np.arange(places.shape[1])], unseen)


def _errors(forecasts: Mapping[str, np.ndarray], seen: np.ndarray) -> dict[str, float]:
    """Root mean squared distances; NaN where nothing was seen."""
    there = np.isfinite(seen).all(-1)
    return {
        name: float(np.sqrt(((path - seen)[there] ** 2).sum() / (there.sum() or np.nan)))
        for name, path in forecasts.items()
    }


def changed_laws(structure: Structure) -> dict[str, Structure]:
    """What may be asked of the model that was never recorded: no friction, twice the restoring."""
    laws = {}
    friction = structure.term(FRICTION)
    if friction is not None:
        laws["no friction"] = _scaled(structure, FRICTION, 0.0)
    external = structure.term(EXTERNAL)
    if external is not None and external.kind == "pendulum":
        laws["half the length"] = _scaled(structure, EXTERNAL, 2.0)
    elif external is not None and external.kind == "trap":
        laws["twice the stiffness"] = _scaled(structure, EXTERNAL, 2.0)
    return laws


def _scaled(structure: Structure, family: str, factor: float) -> Structure:
    parts = [
        structure.of(term) * (factor if term.family == family else 1.0) for term in structure.terms
    ]
    return replace(structure, coefficients=np.concatenate(parts))
