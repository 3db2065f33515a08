"""The collisions that a fitted law has, and whether the bodies' pushes last."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.uncertainty import slopes_of

WIDTHS = (0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 14.0, 20.0)  # frames that a push lasts, tried
AT_ONCE = 1.2  # frames of a push that is still at once
PART = 0.45  # of the change of speed at a meeting, that must come before and after it, at least
SURELY = 15.0  # of log likelihood, by which a push that lasts is likelier
SUDDEN = 8.0  # times the usual acceleration over a step, from which a velocity jumps
TINY = 1e-3  # of the fastest speed, that jumps at least


@dataclass(frozen=True)
class Collision:
    """One that a fitted law has.

    Args:
        clip: its number.
        time: seconds since the clip's first frame.
        change: of the rates of all coordinates, ``(k,)``.
    """

    clip: int
    time: float
    change: np.ndarray


def collisions_of(found: Fit) -> list[Collision]:
    """Those within the frames that a law was fitted to, by clip and time."""
    assert isinstance(found.model.law, Colliding)
    out = []
    rolled = found.model.coordinates(found.values, found.clips)
    for number, (clip, path) in enumerate(zip(found.clips, rolled, strict=True)):
        s, v, steps = path[:, 0], path[:, 1], np.diff(clip.times)
        change = np.diff(v, axis=0)
        sizes = np.linalg.norm(change, axis=1)
        least = SUDDEN * float(np.median(sizes / steps)) * steps
        least += TINY * float(np.linalg.norm(v, axis=1).max())
        each = np.linalg.norm(change.reshape(len(change), found.model.law.bodies, -1), axis=-1)
        both = (each > TINY * sizes[:, None]).sum(1) > 1  # a wall pushes one alone
        for k in np.flatnonzero((sizes > least) & both):
            missed = s[k + 1] - v[k + 1] * steps[k] - s[k]  # of two straight lines that meet
            since = np.clip(-missed @ change[k] / sizes[k] ** 2, 0.0, steps[k])
            out.append(Collision(number, float(clip.times[k] + since), change[k]))
    return out


def lasts(found: Fit) -> bool:
    """Whether what a law leaves shows that bodies push each other before and after they meet.

    A push that lasts rounds the corner off both paths, each by as much as its speed changes. What
    has that shape but is far smaller is a lens's or a tracker's error.
    """
    interval = float(np.median(np.concatenate([np.diff(c.times) for c in found.clips])))
    left, count = weighed(found), sum(r.size for r in found.residuals)
    slope = weighed_slopes(found, found.model, np.concatenate([found.values, *found.geometry]))
    basis = np.linalg.qr(slope / np.maximum(np.linalg.norm(slope, axis=0), 1e-300))[0]
    collisions = collisions_of(found)
    best, wide, part = 0.0, 0.0, 0.0
    for width in WIDTHS:
        rounded = _rounded(found, collisions, width * interval)
        rounded = rounded - basis @ (basis.T @ rounded)
        along, square = float(rounded @ left), float(rounded @ rounded)
        if along <= 0 or square <= 0:
            continue
        kept = max(1 - along**2 / (square * float(left @ left)), np.finfo(float).tiny)
        gain = -0.5 * count * float(np.log(kept))
        if gain > best:
            best, wide, part = gain, width, along / square
    return best > SURELY and wide > AT_ONCE and part > PART


def _rounded(found: Fit, collisions: list[Collision], width: float) -> np.ndarray:
    """By how much a push of this length (seconds, standard deviation) takes paths off a kink."""
    parts = []
    model = found.model
    for number, clip in enumerate(found.clips):
        for body, stretch in enumerate(clip.stretches):
            part, chart, geometry = model.slices[body], model.charts[body], found.geometry[body]
            moved = np.zeros((len(stretch.times), chart.size))
            for x in collisions:
                if x.clip == number:
                    since = (stretch.times - x.time) / width
                    bump = np.exp(-0.5 * since**2) / np.sqrt(2 * np.pi)
                    bump -= np.abs(since) * ndtr(-np.abs(since))
                    moved += width * bump[:, None] * x.change[part]
            shown = chart.shown(moved, geometry) - chart.shown(0 * moved, geometry)
            parts.append((shown * np.sqrt(stretch.trust)[:, None]).ravel())
    return np.concatenate(parts)


def weighed(found: Fit) -> np.ndarray:
    """What a fit leaves of every coordinate of every frame, less where a frame is not trusted."""
    stretches = [s for clip in found.clips for s in clip.stretches]
    pairs = zip(found.residuals, stretches, strict=True)
    return np.concatenate([(r * np.sqrt(s.trust)[:, None]).ravel() for r, s in pairs])


def weighed_slopes(found: Fit, model: Model, joint: np.ndarray) -> np.ndarray:
    """Slopes of the same places by the numbers of a model ``(p,)``, ``(_, p)``."""
    stretches = [s for clip in found.clips for s in clip.stretches]
    pairs = zip(slopes_of(list(found.clips), model, joint, found.spread), stretches, strict=True)
    parts = [(x * np.sqrt(s.trust)[:, None, None]).reshape(-1, len(joint)) for x, s in pairs]
    return np.concatenate(parts)
