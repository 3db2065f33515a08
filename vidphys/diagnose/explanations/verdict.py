"""How far a model may be trusted: by what it explains, and how far ahead it foretells."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.explanations.forecast import Validation

EXPLAINED, MOSTLY, NOT = "explained", "mostly explained", "not explained"
RANK = (NOT, MOSTLY, EXPLAINED)
NEAR = 0.1  # of the motion's spread: farther off, a model no longer foretells
NOISE = 3.0  # or so many standard deviations of what is left by a fit that has all of the motion
ALL, MOST = 0.99, 0.9  # shares of the fitted motion
LONG = 1 / 3  # of the frames held out, that must be foretold
AS_GOOD = 1.2  # times the best simple forecast's error; a constant pull is one of those
SWINGS = 2.0  # or so many, where motion is chaotic
FOUND_AGAIN = 0.9  # or more of those frames, with the last ones: beside a bounce that comes early
MISSED = 1.5  # times the noise, beyond which more than noise is left
SLIGHT = 0.005  # of the spread, that it must be as well
AVERAGED = 5  # frames, over which a forecast's error is taken, at most
BESIDE = 16  # frames held out, for each on either side; a short flight's error doubles within a few


@dataclass(frozen=True)
class Verdict:
    """Whether a recording is explained.

    Args:
        status: one of the three.
        share: of the fitted motion's variance.
        left: root mean square distance that the fit leaves, unit of the positions.
        horizon: seconds of the held-out frames that are foretold; ``None`` where none were held
            out.
        held_out: seconds of them.
        missed: share of the held-out frames that show bodies and are not foretold.
        bent: whether what is left says that the force is not quite the law's.
        stays: whether its law foretells no better than that the bodies stay where they are.
    """

    status: str
    share: float
    left: float
    horizon: float | None
    held_out: float
    missed: float = 0.0
    bent: bool = False
    stays: bool = False

    @property
    def foretells_all(self) -> bool:
        """Whether it has all of the motion, and foretells all that was held out."""
        foretold = self.horizon is not None and self.horizon >= self.held_out
        return foretold and self.share >= ALL and not self.bent


def judge(
    share: float,
    left: float,
    spread: float,
    tail: Validation | None,
    period: float = np.inf,
    same: Collection[str] = (),
    bent: bool = False,
) -> Verdict:
    """The verdict on a model.

    Args:
        share, left: see :class:`Verdict`.
        spread: root mean square distance of the bodies from their means, of the fitted frames.
        tail: the forecast of what was held out.
        period: seconds of a swing, about; two of them are far ahead whatever was held out.
        same: the simple forecasts that say what the model itself says, and are no rivals: of
            bodies that go straight on from where they begin, all but that they stay.
        bent: see :class:`Verdict`; at most mostly explained.
    """
    if tail is None or len(tail.times) < 2:
        status = MOSTLY if share >= ALL else NOT
        return Verdict(status, share, left, None, 0.0)
    enough = NOISE * left if share >= ALL else 0.0
    # A flight goes farther while it is foretold than while it was seen.
    near = max(NEAR * spread, 0.5 * NEAR * tail.errors["persistence"], enough)
    squares = ((tail.forecasts["model"] - tail.seen) ** 2).sum(-1)
    bodies = np.isfinite(squares).sum(-1)
    mean = np.nansum(squares, -1) / np.maximum(bodies, 1)
    miss = _averaged(np.sqrt(np.where(bodies > 0, mean, np.nan)))
    lost = np.flatnonzero(miss > near)
    held_out = float(tail.times[-1] - tail.times[0])
    horizon = float(tail.times[lost[0]] - tail.times[0]) if len(lost) else held_out
    missed = float((miss[bodies > 0] > near).sum() / max((bodies > 0).sum(), 1))
    again = missed < 1 - FOUND_AGAIN and not (miss[-AVERAGED:] > near).any()
    upto = int(lost[0]) + 1 if len(lost) else len(tail.times)
    rivals = tail.forecasts.keys() - {"model", *same}
    own = _rms(tail.forecasts["model"][:upto] - tail.seen[:upto])
    others = [_rms(tail.forecasts[name][:upto] - tail.seen[:upto]) for name in rivals]
    better = own < max(AS_GOOD * min(others), enough)
    # What falls at its last speed goes straight on too: that is no word against its law.
    fair = share >= ALL and tail.gains
    best = min(tail.errors[name] for name in rivals)
    to_the_end = tail.errors["model"] < max(AS_GOOD * best, near if fair else enough)
    far = to_the_end and (again or horizon >= LONG * held_out)
    if share >= ALL and horizon >= held_out and better and not bent:
        status = EXPLAINED
    elif share >= MOST and (better or fair) and (far or horizon >= SWINGS * period):
        status = MOSTLY
    else:
        status = NOT
    return Verdict(status, share, left, horizon, held_out, missed, bent)


def beyond_noise(left: float, noise: float, spread: float) -> bool:
    """Whether a fit leaves more of one coordinate than noise.

    Args:
        left, noise, spread: standard deviations of what it leaves, of the noise, of the motion.
    """
    return left > max(MISSED * noise, SLIGHT * spread)


def _rms(miss: np.ndarray) -> float:
    """Of the frames that are seen; without end if none is."""
    squares = (miss**2).sum(-1)
    seen = np.isfinite(squares)
    return float(np.sqrt(squares[seen].mean())) if seen.any() else np.inf


def _averaged(miss: np.ndarray) -> np.ndarray:
    """The same, averaged over neighbouring frames; frames that show nothing are left out."""
    seen = np.isfinite(miss)
    width = np.ones(min(AVERAGED, 1 + 2 * (len(miss) // BESIDE)))
    total = np.convolve(np.where(seen, miss, 0.0), width, mode="same")
    count = np.convolve(seen.astype(float), width, mode="same")
    return total / np.maximum(count, 1.0)
