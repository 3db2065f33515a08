"""How long errors of the positions last, told from the spectrum of what a model leaves.

A line is taken out of each window first, because where and how fast it began is fitted. The rest
is noise, and what forces have added that the model lacks, which is like random kicks integrated
twice. Its likelihood (restricted, as in Patterson and Thompson, 1971) is compared between noise
without a memory and noise with one, the strength of such forces free in both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from vidphys.diagnose.recordings.colour import Colour
from vidphys.diagnose.weak.windows import Windows

DEGREE = 1  # of the polynomials that are taken out of each window
LEFT = 6  # rows that a window must have left
MEMORIES = (0.3, 0.5, 0.65, 0.75, 0.82, 0.88, 0.93)  # correlations from frame to frame
WHITE = (0.0, 0.25, 0.5, 0.75)
FORCES = np.concatenate([[0.0], np.geomspace(1e-4, 1e8, 37)])
BELIEVED = 12.0  # gain of log likelihood from which a memory is believed


@dataclass(frozen=True)
class _Left:
    """What polynomials leave of windows that have the same times and gaps.

    Args:
        free: rows orthogonal to the polynomials, ``(k, f)``.
        times: ``(f,)``, seconds.
        power: sum over windows and axes of what they read times itself, ``(k, k)``.
        count: of windows and axes.
    """

    free: np.ndarray
    times: np.ndarray
    power: np.ndarray
    count: int


def colour_of(windows: Windows, residual: np.ndarray, believed: float = BELIEVED) -> Colour | None:
    """The memory of the noise; ``None`` where it shows none.

    Args:
        windows: what was recorded; times and gaps of it.
        residual: what a model leaves, ``(w, f, n, d)``, world units.
        believed: gain of log likelihood from which there is one.
    """
    left = list(_left_over(windows, residual))
    if not left or not sum(np.trace(x.power) for x in left) > 0:
        return None
    step = float(np.median(np.diff(windows.times)))
    plain, _ = _likelihood(left, None)
    tried = [Colour(1.0, -step / np.log(r), w) for r in MEMORIES for w in WHITE]
    found = [(*_likelihood(left, colour), colour) for colour in tried]
    gain, variance, colour = max(found, key=lambda x: x[0])
    if gain - plain < believed:
        return None
    return Colour(float(np.sqrt(variance)), colour.memory, colour.white)


def _left_over(windows: Windows, residual: np.ndarray) -> Iterator[_Left]:
    known: dict[bytes, list[tuple[np.ndarray, np.ndarray]]] = {}
    for window, body in np.ndindex(len(windows), residual.shape[2]):
        there = windows.seen[window, :, body]
        if there.sum() < DEGREE + 1 + LEFT:
            continue
        t = windows.times[window, there]
        key = np.round(t, 9).tobytes()
        known.setdefault(key, []).append((t, residual[window, there, body]))
    for same in known.values():
        t = same[0][0] - same[0][0][0]
        basis = chebyshev.chebvander(2 * t / t[-1] - 1, DEGREE)
        free = np.linalg.qr(basis, mode="complete")[0][:, DEGREE + 1 :].T
        x = free @ np.concatenate([x for _, x in same], -1)
        yield _Left(free, t, x @ x.T, x.shape[1])


def _likelihood(left: list[_Left], colour: Colour | None) -> tuple[float, float]:
    """Log likelihood and variance of the noise, at the best strength of fast forces."""
    # Everything is counted in frames, so that one range of strengths does for any recording.
    strengths, powers, counts, size = [], [], [], 0.0
    for part in left:
        unit = np.median(np.diff(part.times))
        covariance = np.eye(len(part.times)) if colour is None else colour.covariance(part.times)
        root = np.linalg.cholesky(part.free @ covariance @ part.free.T)
        t = part.times / unit
        early, late = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
        kicks = part.free @ (early**2 * (3 * late - early) / 6) @ part.free.T
        white = np.linalg.inv(root)
        strength, turn = np.linalg.eigh(white @ kicks @ white.T)
        turned = turn.T @ white
        strengths.append(np.maximum(strength, 0))
        powers.append(((turned @ part.power) * turned).sum(-1))
        counts.append(np.full(len(strength), part.count))
        size += 2 * part.count * float(np.log(np.diag(root)).sum())
    strength, power, count = (np.concatenate(x) for x in (strengths, powers, counts))
    spread = 1 + FORCES[:, None] * strength
    variance = (power / spread).sum(-1) / count.sum()
    total = -0.5 * (count.sum() * np.log(variance) + (count * np.log(spread)).sum(-1) + size)
    best = int(total.argmax())
    return float(total[best]), float(variance[best])
