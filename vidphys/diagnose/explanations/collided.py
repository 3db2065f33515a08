"""What collisions tell of the bodies' masses, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.impacts.pushes import collisions_of
from vidphys.statistics import NORMAL_95


def collided(fit: Fit, bodies: Sequence[int]) -> list[str]:
    """A sentence of each body that is compared with the first; none where bodies do not collide.

    Args:
        fit: of the law.
        bodies: their numbers in the recording, from 0.
    """
    law = fit.model.law
    if not isinstance(law, Colliding):
        return []
    count = len(collisions_of(fit))
    kept = f"momentum is kept in {count} collision{'s' if count > 1 else ''}"
    restitution = f"restitution {_interval(*fit.numbers['restitution'])}"
    out = []
    for place, body in enumerate(bodies[1:], 2):
        ratio, error = fit.numbers[f"mass {place}"]
        heavy, light = body, bodies[0]
        if ratio < 1:
            ratio, error, heavy, light = 1 / ratio, error / ratio**2, light, heavy
        said = (
            f"body {heavy + 1} is {_interval(ratio, error, ' times')} as heavy as body {light + 1}"
        )
        out.append(f"{said}: {kept}; {restitution}")
    if law.rubs and law.space > 1:
        out.append("they rub as they touch; spins are not seen, so how much is not sure")
    return out


def _interval(value: float, error: float, unit: str = "") -> str:
    half = NORMAL_95 * error
    digits = int(np.clip(-np.floor(np.log10(half)), 0, 9)) if half > 0 else 3
    low, high = (f"{x:.{digits}f}" for x in (value - half, value + half))
    return f"{value:.{digits}f}{unit} ({low} to {high})"
