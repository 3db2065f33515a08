"""A model's motion linearised: its small oscillations, and the fastest rate on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import Field, field_of
from vidphys.diagnose.inference.refine import Fitted, with_values
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.weak.spectrum import Mode

NUDGE = 1e-5  # of the places' size, about a rest
ROUNDED = 1e-12  # of a rate, that eigenvalues are wrong by
NUDGE_ON_THE_WAY = 1e-4  # of the places' spread
SHOWN = 1.0  # radians that the fastest motion may turn from frame to frame, to be seen in frames


def modes_of_model(structure: Structure, near: np.ndarray, mass: np.ndarray) -> list[Mode]:
    """Small oscillations about the rest position nearest to ``near`` ``(n, d)``, slowest first."""
    shape = near.shape

    def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        q, v = q.reshape(1, 1, *shape), v.reshape(1, 1, *shape)
        field = Field(q, v, np.zeros((1, 1)), mass[None], np.ones(1))
        return structure.accelerations(field).ravel()

    still = np.zeros(near.size)
    rest = least_squares(lambda q: acceleration(q, still), near.ravel()).x
    step = NUDGE * max(1.0, float(np.abs(near).max()))
    unit = step * np.eye(near.size)
    by_q = np.stack([acceleration(rest + u, still) - acceleration(rest - u, still) for u in unit])
    by_v = np.stack([acceleration(rest, u) - acceleration(rest, -u) for u in unit])
    flow = np.block(
        [
            [np.zeros((near.size, near.size)), np.eye(near.size)],
            [by_q.T / (2 * step), by_v.T / (2 * step)],
        ]
    )
    values = np.linalg.eigvals(flow)
    values.real[np.abs(values.real) < ROUNDED * np.abs(values)] = (
        0.0  # without friction there is none
    )
    found = [Mode(float(x.imag), float(0.0 - x.real)) for x in values if x.imag > 0]
    return sorted(found, key=lambda mode: mode.frequency)


def sure_modes(fitted: Fitted, near: np.ndarray, mass: np.ndarray) -> list[Mode]:
    """The same of a fitted structure, with the standard errors that its numbers' errors leave."""
    best = modes_of_model(fitted.structure, near, mass)
    if not best or not np.isfinite(fitted.covariance).all():
        return best
    slopes = []
    for k, error in enumerate(fitted.errors):
        step = np.zeros_like(fitted.values)
        step[k] = max(float(error), 1e-12)
        sides = [
            modes_of_model(with_values(fitted.structure, fitted.values + way * step), near, mass)
            for way in (1, -1)
        ]
        if any(len(side) != len(best) for side in sides):
            return best  # an oscillation that ends within the error has none that is told
        up, down = ([(m.frequency, m.decay) for m in side] for side in sides)
        slopes.append((np.array(up) - np.array(down)) / (2 * step[k]))
    jacobian = np.array(slopes)  # (numbers, modes, 2)
    spread = np.sqrt(np.einsum("kmi,kl,lmi->mi", jacobian, fitted.covariance, jacobian))
    return [
        Mode(mode.frequency, mode.decay, float(by_decay), float(by_frequency))
        for mode, (by_frequency, by_decay) in zip(best, spread, strict=True)
    ]


def fastest_rate(inference: Inference) -> float:
    """The fastest rate over all places that the bodies came through, radians per second."""
    field = field_of(inference.windows, inference.fitted.paths)
    return _stiffest(field, inference.structure)


def resolved(inference: Inference) -> bool:
    """Whether frames follow each other as fast as the forces change, wherever the bodies came."""
    return fastest_rate(inference) * inference.windows.interval < SHOWN


def _stiffest(field: Field, structure: Structure) -> float:
    count, nodes, bodies, space = field.q.shape
    a = structure.accelerations(field)
    step = NUDGE_ON_THE_WAY * float(field.q.std() or 1.0)
    slopes = np.zeros((count, nodes, bodies * space, bodies * space))
    for body in range(bodies):
        for axis in range(space):
            q = field.q.copy()
            q[:, :, body, axis] += step
            change = (structure.accelerations(replace(field, q=q)) - a) / step
            slopes[..., body * space + axis] = change.reshape(count, nodes, -1)
    if not np.isfinite(slopes).all():
        return 0.0
    return float(np.sqrt(np.abs(np.linalg.eigvals(slopes)).max()))
