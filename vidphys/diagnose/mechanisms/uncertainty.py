"""The last steps of a fit, under the covariance that its own residuals tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.fitted import Fit, Model, missed, residuals_of
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.measurement import (
    Covariance,
    Errors,
    Shapes,
    Stretch,
    trusted,
    unit_errors,
)
from vidphys.diagnose.mechanisms.placewise import (
    REACHES,
    SIZES,
    SLOWLY,
    Equations,
    Field,
    field_of,
    without,
)
from vidphys.diagnose.weak.regression import gram_inverse

NUDGE = 1e-6  # over the size of a number, for derivatives
FLOWN = 1e6  # times the spread, from which a law flew apart
USUAL = {"spin": 0.3, "steeper": 2.0}  # standard deviations, of what few frames may not tell
SHRUNK = (1.0, 0.25, 0.05)  # shares of a step that are tried
SWEEPS = 2  # of Gauss and Newton
FARTHER = 1.5  # times what a fit leaves, from which a step of it is not to be trusted


def with_errors(clips: list[Frames], model: Model, values: np.ndarray, scale: float) -> Fit | None:
    """Gauss and Newton's steps under the covariance of the errors, which the residuals tell."""
    residuals, geometry = residuals_of(clips, model, values)
    if not _near(residuals, scale):
        return None
    stretches = trusted([s for c in clips for s in c.stretches], residuals)
    clips = _retrusted(clips, stretches)
    joint = np.concatenate([values, *geometry])
    least = 1e-9 * scale
    shapes = Shapes(stretches)
    errors, likely = shapes.likeliest(residuals, least)
    prior = _prior(model, len(joint))
    likely -= 0.5 * float(prior @ joint**2)
    covariance = np.eye(len(joint))
    for _ in range(SWEEPS):
        slope = slopes_of(clips, model, joint, scale)
        residuals = _missed(clips, model, joint)
        if not all(np.isfinite(x).all() for x in (*slope, *residuals)):
            return None
        gram, moment = np.diag(prior), -prior * joint
        for stretch, j, r in zip(stretches, slope, residuals, strict=True):
            inverse = Covariance(stretch.times, stretch.trust, errors)
            for axis in range(r.shape[1]):
                solved = inverse.solve(np.concatenate([j[:, axis], r[:, axis, None]], 1))
                gram += j[:, axis].T @ solved[:, :-1]
                moment += j[:, axis].T @ solved[:, -1]
        covariance = gram_inverse(gram)
        step, before = covariance @ moment, likely
        for shrink in SHRUNK:
            trial = joint + shrink * step
            left = _missed(clips, model, trial)
            if not _near(left, scale):
                continue
            sizes, found = shapes.likeliest(left, least)
            found -= 0.5 * float(prior @ trial**2)
            if found >= likely:
                joint, errors, likely, residuals = trial, sizes, found, left
                break
        if likely - before < 0.01:
            break
    count = len(values)
    ends = np.cumsum([count, *(len(g) for g in geometry)])
    parts = [joint[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
    return Fit(
        model,
        joint[:count],
        tuple(parts),
        covariance,
        errors,
        likely,
        tuple(clips),
        tuple(residuals),
    )


def restricted(found: Fit) -> Fit:
    """The same fit with numbers, and their covariance, under all errors that are likely.

    A fit takes up some of the errors that last, and what it leaves tells too little of them. The
    restricted likelihood counts that (Patterson and Thompson 1971, Biometrika 58); errors of all
    sizes and memories that were tried, and those that go with the place, have their say by it.
    """
    clips, stretches = list(found.clips), [s for c in found.clips for s in c.stretches]
    joint = np.concatenate([found.values, *found.geometry])
    slope = slopes_of(clips, found.model, joint, found.spread)
    if not all(np.isfinite(x).all() for x in slope):
        return found
    prior, told = np.diag(_prior(found.model, len(joint))), []
    lawful = [
        replace(s, places=s.places - r) for s, r in zip(stretches, found.residuals, strict=True)
    ]
    bodies, slowly = len(found.model.charts), SLOWLY if found.model.law.pictured else 0.0
    fields = [field_of(lawful[body::bodies], found.spread, slowly) for body in range(bodies)]
    for unit in unit_errors(stretches):
        rest = _equations(stretches, slope, found.residuals, unit)
        parts = [
            _of_field(stretches[b::bodies], slope[b::bodies], found.residuals[b::bodies], f, unit)
            for b, f in enumerate(fields)
        ]
        for size, reach in [(0.0, 1.0), *product(SIZES, REACHES)]:
            both = rest
            for f, part in zip(fields, parts, strict=True):
                both = without(*part, f.sizes(size, reach, found.errors.white), both)
            told.append(_under(both, prior, joint, found))
    likely = np.array([x[0] for x in told])
    weights = np.exp(likely - likely.max())
    weights /= weights.sum()
    steps = np.stack([x[2] for x in told])
    step = weights @ steps
    apart = steps - step
    covariance = np.tensordot(weights, np.stack([x[1] for x in told]), 1)
    covariance += (weights[:, None] * apart).T @ apart
    return replace(_stepped(found, joint, step), covariance=covariance)


def _stepped(found: Fit, joint: np.ndarray, step: np.ndarray) -> Fit:
    """A fit after as much of a step as leaves it near the recording."""
    ends = np.cumsum([len(found.values), *(len(g) for g in found.geometry)])
    for share in SHRUNK:
        trial = joint + share * step
        left = _missed(found.clips, found.model, trial)
        if _near(left, found.spread) and _size_of(left) < FARTHER * _size_of(found.residuals):
            parts = [trial[a:b] for a, b in zip(ends[:-1], ends[1:], strict=True)]
            return replace(
                found, values=trial[: ends[0]], geometry=tuple(parts), residuals=tuple(left)
            )
    return found


def _size_of(residuals: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(sum((x**2).sum() for x in residuals)))


def _equations(
    stretches: Sequence[Stretch],
    slope: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    unit: Errors,
) -> Equations:
    """Under errors of one shape that forget themselves in time."""
    count = slope[0].shape[-1]
    gram, moment = np.zeros((count, count)), np.zeros(count)
    square = log_size = 0.0
    for stretch, j, r in zip(stretches, slope, residuals, strict=True):
        inverse = Covariance(stretch.times, stretch.trust, unit)
        log_size += r.shape[1] * inverse.log_size
        for axis in range(r.shape[1]):
            columns = np.concatenate([j[:, axis], r[:, axis, None]], 1)
            products = columns.T @ inverse.solve(columns)
            gram += products[:-1, :-1]
            moment += products[:-1, -1]
            square += float(products[-1, -1])
    return Equations(gram, moment, square, log_size)


def _of_field(
    stretches: Sequence[Stretch],
    slope: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    field: Field,
    unit: Errors,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Products of one body's field with itself, the slopes and what is missed; see `without`."""
    inner, crossed, told = 0.0, 0.0, 0.0
    for stretch, j, r, modes in zip(stretches, slope, residuals, field.values, strict=True):
        solved = Covariance(stretch.times, stretch.trust, unit).solve(modes)
        inner = inner + modes.T @ solved
        crossed = crossed + np.einsum("fm,fdp->dmp", solved, j)
        told = told + np.einsum("fm,fd->dm", solved, r)
    return np.asarray(inner), np.asarray(crossed), np.asarray(told)


def _under(
    rest: Equations, prior: np.ndarray, joint: np.ndarray, found: Fit
) -> tuple[float, np.ndarray, np.ndarray]:
    """Restricted log likelihood, the numbers' covariance and step, of errors of one shape."""
    gram, moment = rest.gram, rest.moment
    variance = found.errors.white**2
    inverse = gram_inverse(gram + variance * prior)
    for _ in range(2):
        pulled = moment - variance * prior @ joint
        freedom = max(found.count - len(joint) + float((inverse * variance * prior).sum()), 1.0)
        left = max(rest.square - float(moment @ inverse @ moment), 0.0)
        variance = max(left / freedom, np.finfo(float).tiny)
        inverse = gram_inverse(gram + variance * prior)
    size = np.linalg.slogdet(inverse)[1]
    likely = -0.5 * float(freedom * np.log(variance) + rest.log_size - size)
    return likely, variance * inverse, inverse @ pulled


def _prior(model: Model, count: int) -> np.ndarray:
    """Precision of each number before anything is seen; 0 but for ``USUAL`` and the view."""
    prior = np.zeros(count)
    for name in USUAL.keys() & set(model.law.names):
        prior[model.law.names.index(name)] = 1 / USUAL[name] ** 2
    if model.law.pictured:
        end = len(model.law.names)
        prior[end - len(view.USUAL) : end] = 1 / np.array(view.USUAL) ** 2
    return prior


def _near(residuals: Sequence[np.ndarray], scale: float) -> bool:
    """Whether a law's paths stay anywhere near the recording."""
    return all(bool((np.abs(r) < FLOWN * scale).all()) for r in residuals)


def _retrusted(clips: Sequence[Frames], stretches: Sequence[Stretch]) -> list[Frames]:
    each = iter(stretches)
    return [replace(clip, stretches=tuple(next(each) for _ in clip.stretches)) for clip in clips]


@np.errstate(all="ignore")  # as in a fit
def _missed(clips: Sequence[Frames], model: Model, joint: np.ndarray) -> list[np.ndarray]:
    """Residuals ``(…, f, d)`` with the geometry as given, not at its best."""
    at = len(model.law.names) + 2 * model.law.coordinates * len(clips)
    rolled, geometry = [x[..., 0, :] for x in model.coordinates(joint[..., :at], clips)], []
    for chart, part in zip(model.charts, model.slices, strict=True):
        size = chart.columns(np.zeros((1, part.stop - part.start))).shape[-1]
        geometry.append(joint[..., at : at + size])
        at += size
    return missed(clips, model, rolled, geometry, model.view(joint))


def slopes_of(
    clips: Sequence[Frames], model: Model, joint: np.ndarray, scale: float
) -> list[np.ndarray]:
    """Derivatives of the told places by every number, of each residual ``(f, d, p)``."""
    sizes = np.array([1e-3 * _size(model, i, scale) for i in range(len(joint))])
    sizes *= model.slowness(clips, len(joint))
    nudges = NUDGE * np.maximum(np.abs(joint), sizes)
    ends = np.concatenate([joint[None], joint + np.diag(nudges), joint - np.diag(nudges)])
    pairs = (np.split(x[1:], 2) for x in _missed(clips, model, ends))
    return [np.moveaxis(low - high, 0, -1) / (2 * nudges) for high, low in pairs]


def _size(model: Model, number: int, scale: float) -> float:
    """A usual size of a number that may be zero, roughly."""
    names = model.law.names
    if number >= len(names) or names[number].startswith(("force", "wall", "reach")):
        return scale if not any(c.name in ("arc", "angle") for c in model.charts) else 1.0
    return 1.0
