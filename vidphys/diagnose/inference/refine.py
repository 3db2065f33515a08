"""Gauss and Newton's fit of a structure to the frames: paths that obey the model in each window.

The unknowns are the structure's numbers, shared by all windows, and the state at the start of
each window. Within a window the law is solved at the nodes (collocation), so that windows may be
longer than a fixed-point iteration allows, and the errors of the numbers are those of a nonlinear
least-squares fit: nothing in them is left out because the frames are noisy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.inference.menu import PAIR, Field, Term, field_of
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.weak.paths import Paths
from vidphys.diagnose.weak.regression import gram_inverse, gram_solved
from vidphys.diagnose.weak.windows import Windows, apart, together

NUDGE = 1e-5  # over the spread of what is nudged, for derivatives
STEPS = 6
SETTLED = 1e-3  # change of the numbers, in standard errors, below which the fit has settled
AS_TOLD = 0.1  # standard errors, by which numbers differ that are the same
FARTHEST = 1e3  # times what was seen, beyond which a pair force's length means nothing


@dataclass(frozen=True)
class Fitted:
    """A structure with its numbers and how well they are known.

    Args:
        structure: coefficients as fitted; its pair force has the fitted length.
        values: the coefficients, and after them the length of the pair force if it has one.
        covariance: of ``values``.
        paths: through the windows, obeying the model.
        variance: of the noise of one coordinate, as the residual gives it.
        freedom: rows less numbers.
        residual: ``(w, f, n, d)``, zero where not seen.
    """

    structure: Structure
    values: np.ndarray
    covariance: np.ndarray
    paths: Paths
    variance: float
    freedom: int
    residual: np.ndarray

    @property
    def errors(self) -> np.ndarray:
        """Standard errors of ``values``."""
        return np.sqrt(np.diag(self.covariance))

    def as_told_by(self, other: Fitted) -> bool:
        """Whether another fit has the same terms, and numbers that are the same within errors."""
        if [t.name for t in self.structure.terms] != [t.name for t in other.structure.terms]:
            return False
        return bool((np.abs(self.values - other.values) <= AS_TOLD * self.errors).all())

    def place(self, term: Term) -> int:
        """Where the coefficients of a term begin."""
        at = 0
        for other in self.structure.terms:
            if other.kind == term.kind and other.family == term.family:
                return at
            at += len(other.coefficients)
        raise ValueError(f"Fitted: no term '{term.name}'")


def refine(windows: Windows, paths: Paths, structure: Structure, ratio: float = 0.0) -> Fitted:
    """Fit a structure's numbers, and its pair force's length, to the frames.

    Bodies that feel the same and do not act on one another are solved for one by one, which costs
    far less.

    Args:
        windows: what was recorded.
        paths: a first guess.
        structure: terms, and a first guess of their coefficients.
        ratio: variance of random kicks per second over that of the noise.

    Raises:
        FloatingPointError: the fit diverged.
    """
    bodies = paths.q.shape[2]
    alike = structure.term(PAIR) is None and not any(term.apart for term in structure.terms)
    if bodies > 1 and alike:
        each = Paths(*(apart(x) for x in (paths.q, paths.v, paths.a)))
        fitted = refine(windows.apart(), each, structure, ratio)
        found = (fitted.paths.q, fitted.paths.v, fitted.paths.a, fitted.residual)
        *whole, residual = (together(x, bodies) for x in found)
        return replace(fitted, paths=Paths(*whole), residual=residual)
    whiten = windows.whitening(ratio)
    values = _values(structure)
    for _ in range(STEPS):
        linear = _linearised(windows, paths, structure)
        step = _least_squares(windows, linear, whiten, len(values))
        values = values + step.change
        if len(values) > len(structure.coefficients):
            values[-1] = abs(values[-1])  # a length softens alike whatever its sign
        if not (np.isfinite(values).all() and np.isfinite(step.paths.q).all()):
            raise FloatingPointError("refine: the fit diverged")
        structure = with_values(structure, values)
        paths = step.paths
        pair = structure.term(PAIR)
        if pair is not None and pair.scale is not None and pair.scale > FARTHEST * _size(paths.q):
            raise FloatingPointError("refine: the pair force's length left all that was seen")
        if (np.abs(step.change) <= SETTLED * np.sqrt(np.diag(step.covariance)) + 1e-13).all():
            break
    return Fitted(
        structure, values, step.covariance, paths, step.variance, step.freedom, step.residual
    )


def _size(q: np.ndarray) -> float:
    """Of what was seen, world units."""
    return float(np.ptp(q[np.isfinite(q).all(-1)], axis=0).max())


def unrefined(windows: Windows, paths: Paths, structure: Structure) -> Fitted:
    """The numbers as they are, where the fit diverges: their errors are not known, and infinite."""
    values = _values(structure)
    freedom = int(windows.informative.sum()) * windows.frames.shape[-1]
    unknown = np.diag(np.full(len(values), np.inf))
    residual = np.zeros_like(windows.frames)
    return Fitted(structure, values, unknown, paths, structure.misfit, freedom, residual)


def _values(structure: Structure) -> np.ndarray:
    pair = structure.term(PAIR)
    length = [] if pair is None or pair.scale is None else [pair.scale]
    return np.concatenate([structure.coefficients, length])


def with_values(structure: Structure, values: np.ndarray) -> Structure:
    """The structure with other numbers."""
    count = len(structure.coefficients)
    terms = structure.terms
    if len(values) > count:
        scale = float(abs(values[-1]))
        terms = tuple(_rescaled(t, scale) if t.family == PAIR else t for t in terms)
    return replace(structure, terms=terms, coefficients=values[:count])


def _rescaled(term: Term, scale: float) -> Term:
    assert term.remade is not None
    return term.remade(scale)


@dataclass(frozen=True)
class _Linear:
    """Accelerations, places and speeds at the nodes, linear in the unknowns.

    The last axis: 1 for the constant part, the start's places and speeds, the numbers' changes.
    """

    a: np.ndarray  # (w, m, n d, 1 + 2 n d + p)
    q: np.ndarray
    v: np.ndarray


def _linearised(windows: Windows, paths: Paths, structure: Structure) -> _Linear:
    """Panel after panel, each from the state in which the one before it ends."""
    field = field_of(windows, paths)
    count, nodes, bodies, space = paths.q.shape
    size, each = bodies * space, len(windows.panel)
    a, by_q, by_v = _derivatives(field, structure)
    by_values = _by_values(field, structure)
    told = (by_q @ paths.q.reshape(count, nodes, size, 1)) + (
        by_v @ paths.v.reshape(count, nodes, size, 1)
    )
    known = a.reshape(count, nodes, size, 1) - told
    begun = np.zeros((count, nodes, size, 2 * size))
    fixed = np.concatenate([known, begun, by_values], -1)
    q0, v0 = np.zeros((2, count, 1, size, fixed.shape[-1]))
    q0[..., 1 : 1 + size] = v0[..., 1 + size : 1 + 2 * size] = np.eye(size)
    panels = []
    for first in range(0, nodes, each):
        at = slice(first, first + each)
        panels.append(_in_panel(windows, by_q[:, at], by_v[:, at], fixed[:, at], q0, v0))
        q0, v0 = panels[-1].q[:, -1:], panels[-1].v[:, -1:]
    return _Linear(*(np.concatenate([getattr(x, name) for x in panels], 1) for name in "aqv"))


def _in_panel(
    windows: Windows,
    by_q: np.ndarray,
    by_v: np.ndarray,
    fixed: np.ndarray,
    q0: np.ndarray,
    v0: np.ndarray,
) -> _Linear:
    """By collocation: accelerations that are what the law gives where they lead.

    Args:
        by_q, by_v: the law's derivatives ``(w, k, n d, n d)``.
        fixed: the part of the accelerations that neither places nor speeds change
            ``(w, k, n d, c)``.
        q0, v0: where the panel begins, ``(w, 1, n d, c)``.
    """
    count, each, size, columns = fixed.shape
    once, twice = windows.in_panel
    half = (windows.length / (2 * windows.panels))[:, None, None]
    # Operators on the stacked accelerations of all nodes: the law's derivative times an integral.
    feed = by_q[:, :, :, None] * twice[:, :, None, :, None]
    feed += by_v[:, :, :, None] * once[:, :, None, :, None]
    system = np.eye(each * size) - feed.reshape(count, each * size, each * size)
    straight = q0 + (half * (1 + windows.panel[:, None]))[..., None] * v0
    right = fixed + by_q @ straight + by_v @ v0
    solved = np.linalg.solve(system, right.reshape(count, each * size, columns))
    flat = solved.reshape(count, each, -1)
    v = (once @ flat).reshape(fixed.shape) + v0
    q = (twice @ flat).reshape(fixed.shape) + straight
    return _Linear(solved.reshape(fixed.shape), q, v)


def _derivatives(field: Field, structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Accelerations and their derivatives by places and by speeds, ``(w, m, n d, n d)``."""
    a = structure.accelerations(field)
    count, nodes, bodies, space = a.shape
    size = bodies * space
    by_q = np.zeros((count, nodes, size, size))
    by_v = np.zeros((count, nodes, size, size))
    place, speed = (NUDGE * (x.std() or 1.0) for x in (field.q, field.v))
    for axis in range(space):
        # Friction acts on each body by itself: all bodies can be nudged at once.
        v = field.v.copy()
        v[..., axis] += speed
        moved = structure.accelerations(replace(field, v=v)) - a
        for body in range(bodies):
            column = by_v[..., body * space + axis].reshape(count, nodes, bodies, space)
            column[:, :, body] = moved[:, :, body] / speed
            by_v[..., body * space + axis] = column.reshape(count, nodes, size)
            q = field.q.copy()
            q[:, :, body, axis] += place
            change = structure.accelerations(replace(field, q=q)) - a
            by_q[..., body * space + axis] = change.reshape(count, nodes, size) / place
    return a, by_q, by_v


def _by_values(field: Field, structure: Structure) -> np.ndarray:
    """Derivatives of the accelerations by the numbers, ``(w, m, n d, p)``."""
    count, nodes, bodies, space = field.q.shape
    columns = [term.columns(field) for term in structure.terms]
    pair = structure.term(PAIR)
    if pair is not None and pair.scale is not None:
        nudge = 1e-4 * pair.scale
        at = [_rescaled(pair, pair.scale + s).columns(field) for s in (nudge, -nudge)]
        slope = (at[0] - at[1]) @ structure.of(pair) / (2 * nudge)
        columns.append(slope[..., None])
    if not columns:
        return np.zeros((count, nodes, bodies * space, 0))
    joined = np.concatenate(columns, -1)
    return joined.reshape(count, nodes, bodies * space, -1)


def _whitened(whiten: np.ndarray, x: np.ndarray) -> np.ndarray:
    """``(w, n, f, f)`` times ``(w, f, n, d, k)``."""
    by_body = x.transpose(0, 2, 1, 3, 4)
    flat = by_body.reshape(*by_body.shape[:3], -1)
    return (whiten @ flat).reshape(by_body.shape).transpose(0, 2, 1, 3, 4)


@dataclass(frozen=True)
class _Step:
    change: np.ndarray
    covariance: np.ndarray
    paths: Paths
    variance: float
    freedom: int
    residual: np.ndarray


def _least_squares(windows: Windows, linear: _Linear, whiten: np.ndarray, numbers: int) -> _Step:
    count, frames, bodies, space = windows.frames.shape
    size = bodies * space
    seen_at = windows.to_frames @ linear.q.reshape(*linear.q.shape[:2], -1)
    seen_at = seen_at.reshape(count, frames, bodies, space, -1)
    seen_at[..., 0] -= windows.frames
    seen_at = seen_at * windows.seen[..., None, None]
    white = _whitened(whiten, seen_at).reshape(count, frames * size, -1)
    miss, start, slope = white[..., 0], white[..., 1 : 1 + 2 * size], white[..., 1 + 2 * size :]
    basis = np.linalg.qr(start)[0]

    def without_start(x: np.ndarray) -> np.ndarray:
        return x - basis @ (basis.transpose(0, 2, 1) @ x)

    clean, left = without_start(slope), without_start(miss[..., None])
    rows = clean.reshape(count * frames * size, numbers)
    gram = rows.T @ rows
    inverse, change = gram_inverse(gram), -gram_solved(gram, rows.T @ left.ravel())
    after = left[..., 0] + clean @ change
    freedom = int(windows.seen.sum() * space - count * 2 * size - numbers)
    variance = float((after**2).sum() / max(freedom, 1))
    rest = miss + slope @ change
    begun = -np.linalg.pinv(start) @ rest[..., None]
    told = np.concatenate(
        [np.ones((count, 1)), begun[..., 0], np.broadcast_to(change, (count, numbers))], 1
    )
    shape = linear.q.shape[:2] + (bodies, space)
    paths = Paths(
        *(np.einsum("wmik,wk->wmi", x, told).reshape(shape) for x in (linear.q, linear.v, linear.a))
    )
    residual = np.einsum("wfndk,wk->wfnd", seen_at, told)
    return _Step(change, variance * inverse, paths, variance, freedom, residual)
