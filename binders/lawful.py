"""Which of several things that were followed moves as bodies do, and a hand does not: by a law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from binders.hypotheses import Hypothesis

LEAST_SEEN = 2  # frames
UNKNOWN = 0.01  # how well a motion is foretold that is too short to tell
STRIDES = (1, 2, 4, 8)  # frames, over which the motion is foretold
ROUNDS = 8
PIXEL = 0.25  # error of a place, pixels
FASTEST = 90  # per cent of the frames in which it goes no farther than when it moves
RESTING = 0.1  # of that, below which it rests: what is held or has stopped obeys any law
PROVE_LITTLE = 4.0  # frames of motion
SHADOWY = 0.7  # how much less likely what may be a shadow is a body
LARGE = 0.25  # of the picture's shorter side, a radius that few bodies have
SPECK = 1.5  # pixels, a radius below which one sees noise


@dataclass(frozen=True)
class Judged:
    """What speaks for a hypothesis.

    Args:
        seen: share of the frames in which it is.
        foretold: how well its motion is: the mean over its frames of the logarithm of how far it
            goes over how far a law is off.
        steady: how little its size and colour change, at most 1.
        compact: how round it is, at most 1.
        clear: how much it differs from what is behind it, beside the others; at most 1.
        small: how little of the picture it fills, as hands and people do; at most 1.
        fits: how well it fits what a person said of the bodies, at most 1.
        lit: how much of it differs in brightness alone, as a shadow does.
    """

    seen: float
    foretold: float
    steady: float
    compact: float
    clear: float
    small: float
    fits: float
    lit: float

    @property
    def score(self) -> float:
        """Their product, in which some count less."""
        looks = self.steady * self.seen**0.6 * np.sqrt(self.compact) * self.clear * self.small
        return float(self.foretold * looks * self.fits * (1 - SHADOWY * self.lit))


def judge(
    found: list[Hypothesis], times: np.ndarray, side: float, fits: list[float]
) -> list[Judged]:
    """Judge each by itself, and by how clear it is beside the others.

    Args:
        found: what was followed.
        times: of each frame, in units of the usual interval.
        side: of the picture, the shorter one, pixels.
        fits: how well each fits what a person said.
    """
    contrast = [_contrast(h) for h in found]
    most = max(contrast, default=1.0)
    return [
        _judged(h, times, (c / most) ** 0.2, LARGE * side, fit)
        for h, c, fit in zip(found, contrast, fits, strict=True)
    ]


def _contrast(h: Hypothesis) -> float:
    """Mean change of a pixel of it, less where it is but a speck."""
    if not h.seen.any():
        return 0.0
    size = h.usual_size
    return float(np.nanmedian(h.energy / (np.pi * h.size**2))) * (size / (size + SPECK)) ** 3


def _judged(h: Hypothesis, times: np.ndarray, clear: float, large: float, fits: float) -> Judged:
    seen = h.seen
    if seen.sum() < LEAST_SEEN:
        return Judged(0.0, 0.0, 0.0, 0.0, clear, 0.0, fits, 0.0)
    return Judged(
        seen=float(seen.mean()),
        foretold=foretold(h.positions, times),
        steady=steadiness(h),
        compact=float(np.median(h.compact[seen])),
        clear=clear,
        small=float(1 / (1 + (np.median(h.size[seen]) / large) ** 2)),
        fits=fits,
        lit=float(np.median(h.lit[seen])),
    )


def steadiness(h: Hypothesis) -> float:
    """How little the size and colour of what is seen change, at most 1."""
    radius, colour = np.log(h.radius[h.seen]), h.colour[h.seen]
    grown = np.median(np.abs(radius - np.median(radius))) + np.median(np.abs(np.diff(radius)))
    changed = np.median(np.linalg.norm(colour - np.median(colour, axis=0), axis=-1))
    return float(np.exp(-2 * grown - changed))


def foretold(positions: np.ndarray, times: np.ndarray) -> float:
    """How well a linear law foretells the motion, as in :attr:`Judged.foretold`.

    ``x(t + 2m) = c + a x(t + m) + b x(t)`` holds for a body that flies, swings, slides or is
    slowed in proportion to its speed. Some errors may be anything: it may bounce.

    Args:
        positions: ``(t, 2)`` pixels; NaN where it is not seen.
        times: of each frame, in units of the usual interval.
    """
    on_grid = _even(positions, times)
    gains = []
    for stride in STRIDES:
        span = len(on_grid) - 2 * stride
        if span < 3:
            break
        here, after, last = (on_grid[k : span + k] for k in (0, stride, 2 * stride))
        whole = np.isfinite(here + after + last).all(-1)
        if whole.sum() >= 3:
            gains.append(_mean_gain(here[whole], after[whole], last[whole]))
    return float(np.mean(gains)) if gains else UNKNOWN


def _mean_gain(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> float:
    """Mean of the gains of the frames in which it moves; few of them prove little."""
    far = np.hypot(*(second - first).T)
    usual = RESTING * np.percentile(far, FASTEST) + PIXEL
    moves = far**2 / (far**2 + usual**2)
    return float(moves @ _gain(first, second, third) / (moves.sum() + PROVE_LITTLE))


def _gain(first: np.ndarray, second: np.ndarray, third: np.ndarray) -> np.ndarray:
    n = len(first)
    bend, shift = third - 2 * second + first, second - first
    # the law, for the change of speed: bend = c + a' second + b' shift, the same on both axes
    from_middle = second - second.mean(0)
    scale = np.abs(from_middle).max() + 1.0
    design = np.zeros((2 * n, 4))
    for axis in (0, 1):
        rows = slice(axis * n, (axis + 1) * n)
        design[rows, 0] = from_middle[:, axis] / scale
        design[rows, 1] = shift[:, axis] / scale
        design[rows, 2 + axis] = 1
    target = bend.T.ravel()
    rest, left = target, np.hypot(*bend.T)
    for _ in range(ROUNDS):
        weight = np.tile(1 / (1 + (left / (np.median(left) + PIXEL)) ** 2) ** 2, 2)
        normal = design.T @ (weight[:, None] * design) + 1e-6 * np.eye(4)
        rest = target - design @ np.linalg.solve(normal, design.T @ (weight * target))
        left = np.hypot(rest[:n], rest[n:])
    left = left * np.sqrt(2 * n / max(2 * n - 4, 1))
    return 0.5 * np.log1p((np.hypot(*shift.T) / (left + PIXEL)) ** 2)


def _even(positions: np.ndarray, times: np.ndarray) -> np.ndarray:
    """The places at whole times; NaN where no frame is near."""
    seat = np.rint(times - times[0]).astype(int)
    grid = np.full((seat[-1] + 1, 2), np.nan)
    seen = np.isfinite(positions[:, 0])
    grid[seat[seen]] = positions[seen]
    return grid
