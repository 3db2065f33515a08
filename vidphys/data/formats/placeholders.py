"""Numbers that stand for "not seen": a 0 or a -1 that a sensor or a tracker writes instead."""

from __future__ import annotations

import numpy as np

USUAL = (0.0, -1.0, -99.0, 999.0, -999.0, 9999.0, -9999.0, 32767.0, 65535.0)
QUICK = 0.95  # share of the steps that are no longer than what counts as a quick one
FAR = 4.0  # quick steps, from which a place is far from all others
ACROSS = 0.5  # of that distance, that a body goes at most while it was not seen
FEW = 0.5  # of the rows, that are such places at most


def unseen(places: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Places ``(t, n, d)`` with NaN for such numbers, and a line for each.

    All coordinates are the same usual number there, the body comes near it nowhere else, and it
    goes on where it was.
    """
    out, found = places.copy(), dict.fromkeys(USUAL, 0)
    for body in range(places.shape[1]):
        for value in USUAL:
            here = (places[:, body] == value).all(-1)
            if here.any() and _stands_apart(places[:, body], here, value):
                out[here, body] = np.nan
                found[value] += int(here.sum())
    lines = tuple(
        f"{count} {'place' if count == 1 else 'places'} of {value:g}, far from all others, taken "
        "for not seen"
        for value, count in found.items()
        if count
    )
    return out, lines


def _stands_apart(path: np.ndarray, here: np.ndarray, value: float) -> bool:
    """Whether a body ``(t, d)`` leaps to a number in some rows ``(t,)``, and back."""
    others = np.flatnonzero(~here & np.isfinite(path).all(-1))
    if len(others) < 2 or here.sum() > FEW * len(here):
        return False
    steps = np.linalg.norm(np.diff(path[others], axis=0), axis=-1)
    near = float(np.linalg.norm(path[others] - value, axis=-1).min())
    runs = np.array([here[a:b].any() for a, b in zip(others[:-1], others[1:], strict=True)])
    if not runs.any():
        return False
    quick = np.quantile(steps[~runs], QUICK) if not runs.all() else np.inf
    return bool(near > FAR * quick and steps[runs].max() < ACROSS * near)
