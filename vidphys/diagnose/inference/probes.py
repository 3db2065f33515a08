"""Forces that the menu lacks: what they do, and whether a residual asks for them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from vidphys.diagnose.inference.menu import PAIR, Field, Term, axes, pair_terms
from vidphys.diagnose.inference.structures import Structure, price
from vidphys.diagnose.weak.regression import Normal, Rows, gram_inverse, rows_of
from vidphys.diagnose.weak.windows import Windows

SLOW, FAST = 2, 8  # half periods in a recording of the fastest change in time that is asked for
DISTINCT = 1e-4  # share of the largest singular value, from which shapes of a force differ


def _turned(x: np.ndarray) -> np.ndarray:
    """``(…, d)`` turned by a right angle in each plane of two axes, ``(…, d, p)``."""
    columns = []
    for i, j in combinations(range(x.shape[-1]), 2):
        turned = np.zeros_like(x)
        turned[..., i], turned[..., j] = -x[..., j], x[..., i]
        columns.append(turned)
    return np.stack(columns, -1)


def _uneven(x: np.ndarray) -> np.ndarray:
    """``(…, d)`` stretched along the first axis and not another, or sheared, ``(…, d, p)``."""
    stretched, sheared = [], []
    for i, j in combinations(range(x.shape[-1]), 2):
        one, other = np.zeros_like(x), np.zeros_like(x)
        one[..., i], one[..., j] = x[..., i], -x[..., j]
        other[..., i], other[..., j] = x[..., j], x[..., i]
        stretched += [one] if i == 0 else []
        sheared.append(other)
    return np.stack(stretched + sheared, -1)


def _waves(field: Field, most: int) -> list[np.ndarray]:
    """One half period over all that was recorded, two, and so on, each ``(w, m)``."""
    since = (field.t - field.t.min()) / max(np.ptp(field.t), np.finfo(float).tiny)
    return [np.cos(np.pi * k * since) for k in range(1, most + 1)]


def _in_time(field: Field, structure: Structure, most: int) -> np.ndarray:
    force = structure.accelerations(field)
    return np.stack([force * wave[:, :, None, None] for wave in _waves(field, most)], -1)


def _push(field: Field, structure: Structure, most: int) -> np.ndarray:
    each = [wave[:, :, None, None, None] * axes(field) for wave in _waves(field, most)]
    return np.concatenate(each, -1) / field.inertia


def _pair_force(field: Field, structure: Structure) -> np.ndarray:
    pair = structure.term(PAIR)
    assert pair is not None
    return pair.columns(field) @ structure.of(pair)


def _pairs_differ(field: Field, structure: Structure) -> np.ndarray:
    columns = []
    for one, other in list(combinations(range(field.q.shape[2]), 2))[:-1]:
        alone = replace(field, q=field.q[:, :, [one, other]], mass=field.mass[:, [one, other]])
        force = np.zeros_like(field.q)
        force[:, :, [one, other]] = _pair_force(alone, structure)
        columns.append(force)
    return np.stack(columns, -1)


def _bodies_differ(field: Field, structure: Structure) -> np.ndarray:
    of_pairs = structure.term(PAIR) is not None
    force = _pair_force(field, structure) if of_pairs else structure.accelerations(field)
    own = np.eye(field.q.shape[2])[None, None, :, None, :-1]
    return force[..., None] * own


def _nearness(field: Field) -> np.ndarray:
    """Of each body to each other, ``(w, m, n, n)``: about one within their usual distance."""
    reach = np.median(field.distance[np.isfinite(field.distance)]) / 1.5
    return np.exp(-0.5 * (field.distance / reach) ** 2)


def _company(field: Field, structure: Structure) -> np.ndarray:
    force, near = _pair_force(field, structure), _nearness(field).sum(-1)[..., None]
    return np.stack([force * near, force * near**2], -1)


def _mutual_friction(field: Field, structure: Structure) -> np.ndarray:
    between = field.v[:, :, None] - field.v[:, :, :, None]
    near = _nearness(field)[..., None] * between
    return np.stack([between.sum(3), near.sum(3)], -1) / field.inertia


Probe = Callable[[Field, Structure], np.ndarray]
STRENGTHS, PUSH = "strengths that change with time", "a push that changes with time"
NOTHING, ANY, OF_PAIRS = range(3)  # what is found before something else is asked for beside it
PROBES: dict[str, tuple[int, int, int, Probe]] = {
    # name: least dimensions, least bodies, what forces are found, columns
    "a force across the velocity": (2, 1, NOTHING, lambda field, _: _turned(field.v)),
    "friction that differs between directions": (2, 1, NOTHING, lambda field, _: _uneven(field.v)),
    "a force that turns about a point": (2, 1, NOTHING, lambda field, _: _turned(field.q)),
    "a trap that differs between directions": (2, 1, NOTHING, lambda field, _: _uneven(field.q)),
    "strengths that change slowly with time": (1, 1, ANY, partial(_in_time, most=SLOW)),
    STRENGTHS: (1, 1, ANY, partial(_in_time, most=FAST)),
    "a push that changes slowly with time": (1, 1, NOTHING, partial(_push, most=SLOW)),
    PUSH: (1, 1, NOTHING, partial(_push, most=FAST)),
    "bodies that answer differently": (1, 2, ANY, _bodies_differ),
    "friction between bodies": (1, 2, NOTHING, _mutual_friction),
    "pairs that differ": (1, 3, OF_PAIRS, _pairs_differ),
    "pair forces that depend on who else is near": (1, 3, OF_PAIRS, _company),
}
QUICK = STRENGTHS, PUSH


def probes_of(field: Field, structure: Structure) -> dict[str, np.ndarray]:
    """The columns of each that bodies like these may feel beside a structure, by name."""
    space, bodies = field.q.shape[-1], field.q.shape[2]
    found = OF_PAIRS if structure.term(PAIR) is not None else ANY if structure.terms else NOTHING
    return {
        name: probe(field, structure)
        for name, (least_space, least_bodies, least, probe) in PROBES.items()
        if space >= least_space and bodies >= least_bodies and found >= least
    }


def probe_gains(
    normal: Normal, chosen: list[int], places: dict[str, list[int]], ratio: float, floor: float
) -> dict[str, float]:
    """Gain of log likelihood by each force that the data ask for, less its price.

    Args:
        normal: of all columns.
        chosen: columns that stand in the model.
        places: columns of each force.
        ratio: of random kicks in the model, 0 if none.
        floor: see :func:`vidphys.diagnose.inference.structures.all_structures`.
    """

    def log_likelihood(columns: list[int]) -> float:
        misfit = normal.misfit(columns, normal.solve(columns))
        return normal.log_likelihood(misfit, floor)

    without = log_likelihood(chosen)
    gains = {}
    for name, extra in places.items():
        gain = log_likelihood(chosen + extra) - without - price(normal.count, len(extra))
        # Below the floor it is the integrals' own error that has such a shape.
        if gain > 0 and (ratio or _moved(normal, chosen, extra) > floor):
            gains[name] = float(gain)
    return gains


def hidden(
    normal: Normal,
    chosen: list[int],
    places: dict[str, list[int]],
    forces: dict[str, np.ndarray],
    floor: float,
) -> dict[str, float]:
    """How large each force may be and not show: a standard error, as a mean acceleration.

    What was found is held as it is, so that this is what noise hides. A force that hides behind
    other numbers of what was found is not meant: no single throw tells a friction along one axis
    from a wind, and no circle a trap from a force across the velocity. Nor is a change as fast as
    ``FAST``, which few recordings exclude.

    Args:
        normal: of all columns.
        chosen: columns that stand in the model.
        places: columns of each force.
        forces: these columns, ``(w, m, n, d, p)``.
        floor: see :func:`vidphys.diagnose.inference.structures.all_structures`.
    """
    variance = max(normal.misfit(chosen, normal.solve(chosen)) / normal.count, floor**2)
    found = {}
    for name, extra in places.items():
        if name not in QUICK:
            unknown = gram_inverse(normal.gram[np.ix_(extra, extra)])
            x = forces[name].reshape(-1, len(extra))
            points = len(x) / forces[name].shape[3]
            power = np.sum(unknown * (x.T @ x)) / points / len(extra)
            found[name] = float(np.sqrt(variance * power))
    return found


def with_any_shape(
    rows: Rows, windows: Windows, field: Field, pair: Term
) -> tuple[Rows, list[int]]:
    """The rows with columns of a pair force of any shape, and the places of those.

    A force that the menu lacks is asked for beside them: what another law of the distance explains
    as well is no such force.
    """
    shapes = [term for term in pair_terms(field.distance, pair.source) if not term.parts]
    x = rows_of(windows, np.concatenate([term.columns(field) for term in shapes], -1)).x
    x = x[:, np.isfinite(x).all(0)]  # bodies at one place, as two columns of one thing, have none
    x = x / np.maximum(np.abs(x).max(0), np.finfo(float).tiny)  # squares of a 1 / r^13 overflow
    size = np.sqrt((x**2).mean(0) + np.finfo(float).tiny)
    apart, share, _ = np.linalg.svd(x / size, full_matrices=False)
    apart = apart[:, share > DISTINCT * share[0]]
    count = rows.x.shape[1]
    together = replace(rows, x=np.concatenate([rows.x, apart], 1))
    return together, list(range(count, count + apart.shape[1]))


def _moved(normal: Normal, chosen: list[int], extra: list[int]) -> float:
    """Root mean square of what extra columns add to the rows, world units."""
    own = normal.solve(chosen + extra)[len(chosen) :]
    return float(np.sqrt(own @ normal.gram[np.ix_(extra, extra)] @ own / normal.count))
