"""A body on a line or an arc that an unknown sinusoid drives, as a motor does: where fits begin."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from vidphys.diagnose.mechanisms.charts import Angle, Plane
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import Local, halves, local, start_of
from vidphys.diagnose.mechanisms.terms import FORCING

FINER = 4  # trial rates in the width of a line of the spectrum
FASTEST = 0.25  # of the rate at which frames come
BEST = 3  # trial rates with which fits begin
AT_ONCE = 256  # trial rates
RIDGE = 1e-9  # a rate at which what swings does so by itself leaves nothing to project on
VAGUE = 0.1  # of the forcing: a standard error from which it is not told


def forced(clips: Sequence[Frames], angles: bool) -> list[Fit]:
    """Laws of a body that swings, and that a sinusoid drives; none unless one leaves only noise.

    Args:
        clips: of the body.
        angles: whether its coordinate is an angle in radians.
    """
    stretch = clips[0].stretches[0]
    if len(clips) > 1 or stretch.places.shape[1] > 1 or clips[0].inputs is not None:
        return []
    restoring = "pendulum" if angles else "trap"
    law = Law(1, restoring, "linear", forced=True)
    model = Model(law, (Angle() if angles else Plane(1),))
    begun = [
        guess
        for half in halves(clips)
        for guess in _begun(local(stretch.times, stretch.places, half), angles)
    ]
    return [x for x in with_friction_or_none(clips, [(model, begun)]) if _told(x)]


def _begun(seen: Local, angles: bool) -> Iterator[np.ndarray]:
    """The law's numbers by least squares at the trial rates that leave least, and the start."""
    s, v, a = (x[:, 0] for x in (seen.s, seen.v, seen.a))
    one = np.ones_like(s)
    design = np.column_stack([-np.sin(s), np.cos(s), -v] if angles else [-s, one, -v])
    for rate in _likely(design, a, seen.times):
        waves = _waves(seen.times, np.array([rate]))[..., 0]
        found = np.linalg.lstsq(np.column_stack([design, *waves]), a, rcond=None)[0]
        place, speed = start_of(seen)
        if angles:
            rest = np.arctan2(found[1], found[0])
            found = np.concatenate([[np.hypot(*found[:2])], found[2:]])
            place -= rest
        yield np.array([*found, rate, place, speed])


def _likely(design: np.ndarray, a: np.ndarray, times: np.ndarray) -> list[float]:
    """Rates that leave less than those beside them, the least first.

    A body that swings by itself for long seems to be driven by that, and to swing by what drives
    it: two rates far apart, of which the right one need not leave least at a trial rate near it.
    """
    rates = _rates(times)
    left = _left(design, a, times, rates)
    beside = np.pad(left, 1, constant_values=np.inf)
    low = np.flatnonzero((left <= beside[:-2]) & (left <= beside[2:]))
    found = []
    for k in low[np.argsort(left[low], kind="stable")[:BEST]]:
        ends = rates[max(k - 1, 0)], rates[min(k + 1, len(rates) - 1)]
        best = minimize_scalar(
            lambda rate: float(_left(design, a, times, np.array([rate]))[0]),
            bounds=ends,
            method="bounded",
        )
        found.append((float(best.fun), float(best.x)))
    return [rate for _, rate in sorted(found)]


def _rates(times: np.ndarray) -> np.ndarray:
    """Trial rates of what drives it, radians per second."""
    lasts, interval = times[-1] - times[0], np.median(np.diff(times))
    turns = np.arange(1, max(FINER * lasts * FASTEST / interval, 2))
    return 2 * np.pi * turns / (FINER * lasts)


def _waves(times: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Cosines and sines ``(2, t, m)``."""
    turned = times[:, None] * rates
    return np.stack([np.cos(turned), np.sin(turned)])


def _left(design: np.ndarray, a: np.ndarray, times: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Squared accelerations that least squares leave at each trial rate, ``(m,)``."""
    basis = np.linalg.qr(design)[0]
    rest = a - basis @ (basis.T @ a)
    left = []
    for some in np.array_split(rates, max(len(rates) // AT_ONCE, 1)):
        waves = _waves(times, some)
        waves = waves - basis @ (basis.T @ waves)
        gram = np.einsum("itm,jtm->mij", waves, waves)
        along = np.einsum("itm,t->mi", waves, rest)
        gains = np.linalg.solve(gram + RIDGE * np.eye(2), along[..., None])[..., 0]
        left.append(rest @ rest - (gains * along).sum(-1))
    return np.concatenate(left)


def _told(found: Fit) -> bool:
    """Whether only noise is left, and the recording tells what drives the body."""
    pushes = [found.numbers[name] for name in FORCING[:-1]]
    size = float(np.linalg.norm([value for value, _ in pushes]))
    return (
        found.errors.smooth < found.errors.white
        and max(error for _, error in pushes) < VAGUE * size
    )
