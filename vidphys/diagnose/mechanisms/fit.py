"""Fitting a law to whole recordings: robust least squares, then the errors' own covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from vidphys.diagnose.mechanisms.charts import Chart
from vidphys.diagnose.mechanisms.impacts import Impact, find_impacts
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.measurement import (
    Covariance,
    Errors,
    Stretch,
    likeliest_errors,
    trusted,
)
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.weak.regression import gram_inverse

FEWEST = 8  # frames that a fit begins with
GROWTH = 1.7
NUDGE = 1e-6
SWEEPS = 2  # of the fit under the errors' covariance
LAST, ON_THE_WAY = 60, 20  # steps of a fit to all frames, and to some
MANY = 4  # clips, each with a start of its own, from which fewer steps are made
TRIED = 3  # of several guesses, those that begin nearest
BEHIND = 25.0  # times the best law's cost, from which another one is dropped
HELD = 0.003  # of the spread: what moving a wall by a spread costs
TINY = 1e-4  # of SOFT squared: the cost of a frame below which no law is dropped
MOST = 1e6  # times the spread, by which a law that flew apart counts as missing a frame
SOFT = 0.03  # of the spread: errors beyond count by their size while a fit begins


@dataclass(frozen=True)
class Frames:
    """What was seen in one clip.

    Args:
        times: of all frames, seconds from the clip's first, ``(t,)``.
        seen: frames in which each body was seen, of each body ``(f,)``.
        stretches: of each body, at those frames.
        begin: seconds from the recording's first frame to the first of these.
    """

    times: np.ndarray
    seen: tuple[np.ndarray, ...]
    stretches: tuple[Stretch, ...]
    begin: float = 0.0

    @cached_property
    def impacts(self) -> list[Impact]:
        """Of the first body."""
        return find_impacts(self.stretches[0].times, self.stretches[0].places)

    def upto(self, count: int) -> Frames:
        """The first frames."""
        few = [int((seen < count).sum()) for seen in self.seen]
        return Frames(
            self.times[:count],
            tuple(seen[:n] for seen, n in zip(self.seen, few, strict=True)),
            tuple(x.upto(n) for x, n in zip(self.stretches, few, strict=True)),
        )


def frames_of(motion: Motion, bodies: Sequence[int] | None = None) -> list[Frames]:
    """The frames of each clip in which bodies were seen, all bodies if none are named."""
    chosen = range(motion.bodies) if bodies is None else bodies
    clips = []
    for path, seen, times in zip(motion.positions, motion.seen, motion.times, strict=True):
        at = [np.flatnonzero(seen[:, body]) for body in chosen]
        since = times - times[0]
        stretches = tuple(
            Stretch(since[i], path[i, body], np.ones(len(i)))
            for i, body in zip(at, chosen, strict=True)
        )
        clips.append(Frames(since, tuple(at), stretches))
    return clips


@dataclass(frozen=True)
class Model:
    """A law and how its coordinates show: those of the first body first."""

    law: Law
    charts: tuple[Chart, ...]

    @cached_property
    def slices(self) -> list[slice]:
        """Coordinates of each body."""
        ends = np.cumsum([chart.size for chart in self.charts])
        return [slice(int(e) - c.size, int(e)) for e, c in zip(ends, self.charts, strict=True)]

    def split(self, values: np.ndarray, clips: int) -> tuple[np.ndarray, np.ndarray]:
        """The law's numbers, and the starts ``(clips, 2, k)``."""
        count = len(self.law.names)
        return values[:count], values[count:].reshape(clips, 2, self.law.coordinates)

    def coordinates(self, values: np.ndarray, clips: Sequence[Frames]) -> list[np.ndarray]:
        """Coordinates and rates of every frame of each clip, ``(t, 2, k)``."""
        numbers, starts = self.split(values, len(clips))
        return [
            self.law.roll(numbers, start, clip.times)
            for start, clip in zip(starts, clips, strict=True)
        ]


@dataclass(frozen=True)
class Fit:
    """A law fitted to a recording.

    Args:
        model: law and charts.
        values: the law's numbers, then the starts.
        geometry: numbers of each body's chart.
        covariance: of the values and then the geometry.
        errors: sizes of what the law misses.
        log_likelihood: of the recording.
        clips: what it was fitted to.
        residuals: of each clip, of each body, ``(f, d)``.
    """

    model: Model
    values: np.ndarray
    geometry: tuple[np.ndarray, ...]
    covariance: np.ndarray
    errors: Errors
    log_likelihood: float
    clips: tuple[Frames, ...]
    residuals: tuple[np.ndarray, ...]

    @property
    def count(self) -> int:
        """Recorded coordinates."""
        return sum(r.size for r in self.residuals)

    @property
    def score(self) -> float:
        """Log likelihood less Schwarz's price of every number."""
        return self.log_likelihood - 0.5 * np.log(self.count) * len(self.covariance)

    @property
    def left(self) -> float:
        """Root mean square distance that the fit leaves, unit of the positions."""
        return _rms(self.residuals)

    @property
    def spread(self) -> float:
        """Root mean square distance of the bodies from their means."""
        places = [s.places - s.places.mean(0) for clip in self.clips for s in clip.stretches]
        return _rms(places)

    @property
    def numbers(self) -> dict[str, tuple[float, float]]:
        """The law's numbers with their standard errors."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0))
        names = self.model.law.names
        return {name: (float(self.values[i]), float(errors[i])) for i, name in enumerate(names)}

    @property
    def driven(self) -> bool:
        """Whether its friction adds energy."""
        return "linear" in self.model.law.frictions and self.numbers["linear"][0] < 0

    @property
    def kinds(self) -> frozenset[str]:
        """Of the law's terms; a friction that adds energy is a drive."""
        kinds = self.model.law.kinds
        return kinds - {"linear"} | {"drive"} if self.driven else kinds

    def path(self, times: np.ndarray, clip: int = -1) -> np.ndarray:
        """Places ``(t, n, d)`` at increasing seconds since the clip's first frame."""
        numbers, starts = self.model.split(self.values, len(self.clips))
        since = np.concatenate([[0.0], times]) if times[0] > 0 else times
        rolled = self.model.law.roll(numbers, starts[clip], since)[-len(times) :, 0]
        return shown(self.model, rolled, self.geometry)


def shown(model: Model, s: np.ndarray, geometry: Sequence[np.ndarray]) -> np.ndarray:
    """Places ``(t, n, d)`` of coordinates ``(t, k)``."""
    each = zip(model.charts, model.slices, geometry, strict=True)
    return np.stack([chart.shown(s[:, part], numbers) for chart, part, numbers in each], 1)


def _rms(parts: Sequence[np.ndarray]) -> float:
    total = sum(float((x**2).sum()) for x in parts)
    return float(np.sqrt(total / max(sum(len(x) for x in parts), 1)))


def fit(clips: Sequence[Frames], model: Model, guess: np.ndarray) -> Fit | None:
    """Fit a law to all frames from numbers that are nearly right; ``None`` where it fails."""
    tries = LAST if len(clips) < MANY else ON_THE_WAY
    found = _least_squares(clips, model, guess, spread_of(clips), tries)
    return None if found is None else _with_errors(list(clips), model, found.x, spread_of(clips))


def race(
    clips: Sequence[Frames], runners: Sequence[tuple[Model, Sequence[np.ndarray]]]
) -> list[Fit]:
    """Fit several laws over ever longer beginnings of the recording, and drop those that fall back.

    A rate that is guessed is not yet right over many swings, so a fit begins with few frames.

    Args:
        clips: what was seen.
        runners: laws with guesses: the law's numbers, then the starts of all clips.
    """
    scale, running = spread_of(clips), list(runners)
    longest = max(len(c.times) for c in clips)
    for count in _lengths(longest):
        part = [clip.upto(count) for clip in clips]
        tries = LAST if count == longest else ON_THE_WAY
        ended = []
        for model, guesses in running:
            near = sorted(guesses, key=lambda x: _cost(part, model, x, scale))[:TRIED]
            found = [_least_squares(part, model, guess, scale, tries) for guess in near]
            good = [x for x in found if x is not None]
            if good:
                best = min(good, key=lambda x: x.cost)
                ended.append((float(best.cost), model, best.x))
        if not ended:
            return []
        most = BEHIND * max(min(cost for cost, _, _ in ended), count * SOFT**2 * TINY)
        running = [(model, [x]) for cost, model, x in ended if cost <= most]
    fits = [_with_errors(list(clips), model, x[0], scale) for model, x in running]
    return [x for x in fits if x is not None]


def spread_of(clips: Sequence[Frames]) -> float:
    """Size of the motion, unit of the positions."""
    parts = [s.places.var(0).sum() for clip in clips for s in clip.stretches if len(s.places)]
    return max(float(np.sqrt(np.mean(parts))), np.finfo(float).tiny)


def _lengths(frames: int) -> list[int]:
    """How many frames are fitted, one after the other."""
    counts, count = [], 2 * FEWEST
    while count < frames:
        counts.append(count)
        count = int(GROWTH * count)
    return [*counts, frames]


def _missing(clips: Sequence[Frames], model: Model, values: np.ndarray, scale: float) -> np.ndarray:
    parts = [r.ravel() for r in residuals_of(clips, model, values)[0]]
    joined = np.concatenate(parts) / scale
    return np.where(np.isfinite(joined), np.clip(joined, -MOST, MOST), MOST)


def _held(model: Model, scale: float) -> np.ndarray:
    """What holds numbers at their guess that the first frames say nothing of, those of a wall."""
    held = np.zeros(len(model.law.names) + 2 * model.law.coordinates * 64)
    for i, name in enumerate(model.law.names):
        if name.startswith("wall"):
            held[i] = HELD / (1.0 if model.charts[0].name in ("arc", "angle") else scale)
        elif name.startswith(("restitution", "along", "turn")):
            held[i] = HELD
    return held


def _cost(clips: Sequence[Frames], model: Model, values: np.ndarray, scale: float) -> float:
    left = _missing(clips, model, values, scale) / SOFT
    return float((SOFT**2 * (np.sqrt(1 + left**2) - 1)).sum())


def _least_squares(
    clips: Sequence[Frames], model: Model, guess: np.ndarray, scale: float, tries: int
) -> OptimizeResult | None:
    held = _held(model, scale)

    def left(values: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [_missing(clips, model, values, scale), held[: len(guess)] * (values - guess)]
        )

    try:
        found = least_squares(
            left,
            guess,
            loss="soft_l1",
            f_scale=SOFT,
            x_scale="jac",
            max_nfev=tries,
            xtol=1e-7,
            ftol=1e-7,
        )
    except (ValueError, np.linalg.LinAlgError):
        return None
    return found if np.isfinite(found.x).all() else None


def residuals_of(
    clips: Sequence[Frames], model: Model, values: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals of each clip and body ``(f, d)`` and each body's geometry, at its best."""
    rolled = [x[:, 0] for x in model.coordinates(values, clips)]
    geometry = [
        _geometry(clips, rolled, chart, part, body)
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True))
    ]
    out = []
    for clip, s in zip(clips, rolled, strict=True):
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True)):
            told = chart.shown(s[clip.seen[body], part], geometry[body])
            out.append(clip.stretches[body].places - told)
    return out, geometry


def _geometry(
    clips: Sequence[Frames], rolled: Sequence[np.ndarray], chart: Chart, part: slice, body: int
) -> np.ndarray:
    """The numbers of a chart by least squares, given the coordinates."""
    s = np.concatenate([x[c.seen[body], part] for x, c in zip(rolled, clips, strict=True)])
    columns = chart.columns(s)
    if columns.shape[-1] == 0 or not np.isfinite(columns).all():
        return np.zeros(columns.shape[-1])
    places = np.concatenate([c.stretches[body].places for c in clips])
    trust = np.concatenate([c.stretches[body].trust for c in clips])
    weight = np.sqrt(trust)[:, None]
    rest = (places - chart.fixed(s)) * weight
    design = (columns * weight[..., None]).reshape(-1, columns.shape[-1])
    return np.linalg.lstsq(design, rest.ravel(), rcond=None)[0]


def _with_errors(clips: list[Frames], model: Model, values: np.ndarray, scale: float) -> Fit | None:
    """Gauss and Newton's steps under the covariance of the errors, which the residuals tell."""
    residuals, geometry = residuals_of(clips, model, values)
    if not all(np.isfinite(r).all() for r in residuals):
        return None
    stretches = trusted([s for c in clips for s in c.stretches], residuals)
    clips = _retrusted(clips, stretches)
    joint = np.concatenate([values, *geometry])
    least = 1e-9 * scale
    errors, likely = likeliest_errors(stretches, residuals, least)
    covariance = np.eye(len(joint))
    for _ in range(SWEEPS):
        slope = _slopes(clips, model, joint, scale)
        if not all(np.isfinite(x).all() for x in slope):
            return None
        residuals = _missed(clips, model, joint)
        gram, moment = np.zeros((len(joint),) * 2), np.zeros(len(joint))
        for stretch, j, r in zip(stretches, slope, residuals, strict=True):
            inverse = Covariance(stretch.times, stretch.trust, errors)
            for axis in range(r.shape[1]):
                solved = inverse.solve(np.concatenate([j[:, axis], r[:, axis, None]], 1))
                gram += j[:, axis].T @ solved[:, :-1]
                moment += j[:, axis].T @ solved[:, -1]
        covariance = gram_inverse(gram)
        step, before = covariance @ moment, likely
        for shrink in (1.0, 0.25, 0.05):
            trial = joint + shrink * step
            missed = _missed(clips, model, trial)
            if not all(np.isfinite(r).all() for r in missed):
                continue
            found = likeliest_errors(stretches, missed, least)
            if found[1] >= likely:
                joint, (errors, likely), residuals = trial, found, missed
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


def _retrusted(clips: Sequence[Frames], stretches: Sequence[Stretch]) -> list[Frames]:
    each = iter(stretches)
    return [replace(clip, stretches=tuple(next(each) for _ in clip.stretches)) for clip in clips]


def _missed(clips: Sequence[Frames], model: Model, joint: np.ndarray) -> list[np.ndarray]:
    """Residuals with the geometry as given, not at its best."""
    count = len(model.law.names) + 2 * model.law.coordinates * len(clips)
    rolled, at, out = model.coordinates(joint[:count], clips), count, []
    geometry = []
    for chart, part in zip(model.charts, model.slices, strict=True):
        size = chart.columns(rolled[0][:1, 0, part]).shape[-1]
        geometry.append(joint[at : at + size])
        at += size
    for clip, s in zip(clips, rolled, strict=True):
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True)):
            told = chart.shown(s[clip.seen[body], 0, part], geometry[body])
            out.append(clip.stretches[body].places - told)
    return out


def _slopes(
    clips: Sequence[Frames], model: Model, joint: np.ndarray, scale: float
) -> list[np.ndarray]:
    """Derivatives of the told places by every number, of each residual ``(f, d, p)``."""
    columns: list[list[np.ndarray]] = []
    for i, value in enumerate(joint):
        nudge = NUDGE * max(abs(float(value)), 1e-3 * _size(model, i, scale))
        up, down = joint.copy(), joint.copy()
        up[i] += nudge
        down[i] -= nudge
        pairs = zip(_missed(clips, model, up), _missed(clips, model, down), strict=True)
        columns.append([(low - high) / (2 * nudge) for high, low in pairs])
    return [np.stack([c[k] for c in columns], -1) for k in range(len(columns[0]))]


def _size(model: Model, number: int, scale: float) -> float:
    """A usual size of a number that may be zero, roughly."""
    names = model.law.names
    if number >= len(names) or names[number].startswith(("force", "wall")):
        return scale if not any(c.name in ("arc", "angle") for c in model.charts) else 1.0
    return 1.0
