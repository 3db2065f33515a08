"""Smooth paths through the windows: first by polynomials, later by the model itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from vidphys.diagnose.weak.windows import UNSEEN, Windows


@dataclass(frozen=True)
class Paths:
    """Positions, velocities and accelerations at the nodes of windows, ``(w, m, n, d)`` each."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray

    def only(self, kept: np.ndarray) -> Paths:
        """Those through some windows, by their numbers ``(k,)``."""
        return Paths(self.q[kept], self.v[kept], self.a[kept])


def smooth(windows: Windows, sigma: float) -> Paths:
    """Polynomials of the lowest degree that leave no more than the noise.

    Args:
        windows: what was recorded.
        sigma: of the noise, world units.
    """
    size = windows.frames.shape[1]
    highest = max(2, min(size - 3, len(windows.nodes) - 1, 15))
    best, least = None, np.inf
    for degree in range(1, highest + 1):
        coefficients, misfit, free = _fit(windows, degree)
        used = windows.seen.sum() * windows.frames.shape[-1] - free
        # Akaike's criterion with the noise known: misfit over variance, and two for each number.
        score = misfit / sigma**2 + 2 * used
        if score < least:
            best, least = coefficients, score
    assert best is not None
    return _at_nodes(windows, best)


def _fit(windows: Windows, degree: int) -> tuple[np.ndarray, float, int]:
    """Coefficients ``(w, n, degree + 1, d)``, summed squared misfit, degrees of freedom left."""
    place = np.clip(2 * windows.times / windows.length[:, None] - 1, -1, 1)
    basis = chebyshev.chebvander(place, degree)[:, None]
    seen = windows.seen.transpose(0, 2, 1)[..., None]
    frames = windows.frames.transpose(0, 2, 1, 3)
    if windows.colour is None:
        weighted, frames = basis * seen, frames * seen
        coefficients = windows.inverse(weighted) @ frames
    else:
        white = windows.whitening()
        weighted, frames = white @ (basis * seen), white @ (frames * seen)
        coefficients = np.linalg.pinv(weighted) @ frames
    misfit = float(((weighted @ coefficients - frames) ** 2).sum())
    free = np.clip(windows.seen.sum(1) - degree - 1, 0, None).sum() * frames.shape[-1]
    return coefficients, misfit, int(free)


def _at_nodes(windows: Windows, coefficients: np.ndarray) -> Paths:
    per_second = (2 / windows.length)[:, None, None, None]
    values = []
    for order in range(3):
        derived = chebyshev.chebder(coefficients, order, axis=2) if order else coefficients
        basis = chebyshev.chebvander(windows.nodes, derived.shape[2] - 1)
        moved = (basis @ derived) * per_second**order
        values.append(moved.transpose(0, 2, 1, 3))
    return Paths(*values)


def splined(windows: Windows, sigma: float) -> Paths:
    """Smoothing splines, for windows too long for a polynomial."""
    from scipy.interpolate import UnivariateSpline  # a tenth of a second to load, and seldom asked

    shape = (len(windows), len(windows.nodes), *windows.frames.shape[2:])
    q, v, a = (np.zeros(shape) for _ in range(3))
    at = (windows.nodes + 1) / 2
    for w, body, axis in np.ndindex(shape[0], shape[2], shape[3]):
        seen = windows.seen[w, :, body]
        misfit = max(sigma, np.finfo(float).eps) ** 2 * seen.sum()
        t, x = windows.times[w, seen], windows.frames[w, seen, body, axis]
        spline = UnivariateSpline(t, x, k=min(5, len(t) - 1), s=misfit)
        places = at * windows.length[w]
        for order, out in enumerate((q, v, a)):
            out[w, :, body, axis] = spline.derivative(order)(places) if order else spline(places)
    return Paths(q, v, a)


def integrated(windows: Windows, a: np.ndarray) -> Paths:
    """Paths with these accelerations ``(w, m, n, d)`` that pass closest to the frames."""
    half = (windows.length / 2)[:, None, None]
    flat = a.reshape(*a.shape[:2], -1)
    v = half * (windows.once @ flat)
    q = half * (windows.once @ v)
    rest = windows.frames - (windows.to_frames @ q).reshape(windows.frames.shape)
    seen = windows.seen.transpose(0, 2, 1)[..., None]
    line = np.stack([np.ones_like(windows.times), windows.times], -1)[:, None] * seen
    start = windows.inverse(line) @ (rest.transpose(0, 2, 1, 3) * seen)  # (w, n, 2, d)
    since = (windows.node_times - windows.begin[:, None])[:, :, None, None]
    place, speed = start[:, None, :, 0], start[:, None, :, 1]
    return Paths(q.reshape(a.shape) + place + speed * since, v.reshape(a.shape) + speed, a)


def with_kicks(windows: Windows, paths: Paths, ratio: float) -> Paths:
    """Paths that also follow what random kicks did: the likeliest ones, given the frames.

    Args:
        windows: what was recorded.
        paths: of the model without kicks.
        ratio: variance of the kicks per second over that of the noise of a position.
    """
    frame, node = windows.times, windows.node_times - windows.begin[:, None]
    # Of each body: the heavier, the less a kick of the same strength moves it.
    strength = (ratio / windows.mass**2)[:, :, None, None]
    unseen = np.where(windows.seen, 0.0, UNSEEN).transpose(0, 2, 1)[..., None]
    covariance = windows.errors + strength * _displaced(frame, frame)[:, None]
    inverse = np.linalg.inv(covariance + unseen * np.eye(frame.shape[1]))
    line = np.stack([np.ones_like(frame), frame], -1)[:, None]
    flat = paths.q.reshape(*paths.q.shape[:2], -1)
    rest = windows.frames - (windows.to_frames @ flat).reshape(windows.frames.shape)
    rest = rest.transpose(0, 2, 1, 3)  # (w, n, f, d)
    across = line.transpose(0, 1, 3, 2) @ inverse
    start = np.linalg.solve(across @ line, across @ rest)
    pull = inverse @ (rest - line @ start)
    moved = strength * _displaced(node, frame)[:, None] @ pull
    sped = strength * _sped(node, frame)[:, None] @ pull
    begun = np.stack([np.ones_like(node), node], -1)[:, None] @ start
    q = paths.q + (moved + begun).transpose(0, 2, 1, 3)
    v = paths.v + (sped + start[:, :, 1:2]).transpose(0, 2, 1, 3)
    return Paths(q, v, paths.a)


def _displaced(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Covariance of two displacements by unit kicks since time 0, ``(w, s, t)``."""
    early = np.minimum(s[:, :, None], t[:, None])
    late = np.maximum(s[:, :, None], t[:, None])
    return early**2 * (3 * late - early) / 6


def _sped(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Covariance of a speed at ``s`` and a displacement at ``t``, ``(w, s, t)``."""
    early = np.minimum(s[:, :, None], t[:, None])
    return early * t[:, None] - early**2 / 2
