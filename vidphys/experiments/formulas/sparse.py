"""A sparse regression beside the search: powers of the place and the speed, by the weak form.

Its words have no constants of their own, and it always answers.
"""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.formula.grammar import Term, words

WINDOW, STRIDE = 21, 7  # frames of a bump, and from one to the next
DRAG = "v"


def sparse_law(x: np.ndarray, times: np.ndarray) -> tuple[tuple[str, ...], bool]:
    """Names of the words of a force, sorted, and whether there is friction.

    Words are added one at a time, the most needed first, as long as the Bayesian information
    criterion falls.

    Args:
        x: places ``(1, frames)``.
        times: seconds ``(1, frames)``, evenly spaced.
    """
    places, step = x[0], float(times[0, 1] - times[0, 0])
    positive = bool(places.min() > 0)
    plain = [term for term in words(positive) if not term.constants]
    columns, right = _weak(places, step, plain)
    kept: list[int] = []
    score = np.inf
    while len(kept) < columns.shape[1]:
        more = [[*kept, k] for k in range(columns.shape[1]) if k not in kept]
        scores = [_criterion(columns[:, some], right) for some in more]
        if min(scores) > score:
            break
        score, kept = min(scores), more[int(np.argmin(scores))]
    names = [*(term.name for term in plain), DRAG]
    found = [names[k] for k in kept]
    return tuple(sorted(name for name in found if name != DRAG)), DRAG in found


def _weak(x: np.ndarray, step: float, plain: list[Term]) -> tuple[np.ndarray, np.ndarray]:
    """Words against bumps ``(bumps, words)``, and the acceleration against them."""
    s = np.linspace(-1, 1, WINDOW)
    width = step * (WINDOW - 1) / 2
    bump = (1 - s**2) ** 4
    first = -8 * s * (1 - s**2) ** 3 / width
    second = (-8 * (1 - s**2) ** 3 + 48 * s**2 * (1 - s**2) ** 2) / width**2
    views = np.lib.stride_tricks.sliding_window_view(x, WINDOW)[::STRIDE]
    columns = [term.columns[0](views, ()) @ bump for term in plain]
    return np.stack([*columns, -views @ first], -1), views @ second


def _criterion(columns: np.ndarray, right: np.ndarray) -> float:
    scale = np.linalg.norm(columns, axis=0) + 1e-300
    rest = right - columns / scale @ np.linalg.lstsq(columns / scale, right, rcond=1e-10)[0]
    count = len(right)
    return float(count * np.log(rest @ rest) + columns.shape[1] * np.log(count))
