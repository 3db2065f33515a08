"""A law with its charts, what it misses of a recording, and how well its numbers are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.charts import Arc, Chart
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.measurement import Errors

GOOD = 0.03  # of the spread: what a law leaves at most that holds from the first frame on
TELLS = 1e-12  # of what a chart's number moves: a ridge, so that one that moves nothing is 0
USUAL_SLANT = view.FAR * view.USUAL[0]  # tangent


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
        """The law's numbers ``(…, m)``, and the starts ``(…, clips, 2, k)``, of ``(…, v)``."""
        count = len(self.law.names)
        shape = (*values.shape[:-1], clips, 2, self.law.coordinates)
        return values[..., :count], values[..., count:].reshape(shape)

    def slowness(self, clips: Sequence[Frames], count: int) -> np.ndarray:
        """What a usual size of each number is times, where frames are many seconds apart.

        Args:
            clips: that the model is fitted to.
            count: of all numbers: those of the law, the starts of all clips, the charts'.
        """
        still = self.law.coordinates * [0]
        powers = [*self.law.seconds, *([*still, *(p - 1 for p in still)] * len(clips))]
        interval = float(np.median(np.concatenate([np.diff(clip.times) for clip in clips])))
        return max(interval, 1.0) ** np.array([*powers, *(count - len(powers)) * [0]], float)

    def view(self, values: np.ndarray) -> np.ndarray | None:
        """How a camera sees the plane of motion, ``(…, 3)``; ``None`` where none does."""
        if not self.law.pictured:
            return None
        count = len(self.law.names)
        return values[..., count - len(view.NAMES) : count]

    def coordinates(self, values: np.ndarray, clips: Sequence[Frames]) -> list[np.ndarray]:
        """Coordinates and rates of every frame of each clip, ``(t, 2, k)`` or ``(b, t, 2, k)``.

        Args:
            values: the law's numbers, then the starts of all clips, ``(v,)`` or ``(b, v)``.
            clips: as many.
        """
        numbers, starts = self.split(values, len(clips))
        each = zip(np.moveaxis(starts, -3, 0), clips, strict=True)
        return [self._rolled(numbers, start, clip) for start, clip in each]

    def _rolled(self, numbers: np.ndarray, start: np.ndarray, clip: Frames) -> np.ndarray:
        """One clip's, of one or of many ``(b, m)``; what moves as the first is not rolled again."""
        if numbers.ndim == 1:
            return self.law.roll(numbers, start, clip.times, clip.inputs)
        asked = np.concatenate([numbers, start.reshape(len(numbers), -1)], -1)
        camera = self.view(asked)
        if camera is not None:
            camera[:] = 0.0  # it moves nothing
        own = (asked != asked[0]).any(-1)
        own[0] = True
        rolled = self.law.roll(numbers[own], start[own], clip.times, clip.inputs)
        return rolled[np.where(own, np.cumsum(own) - 1, 0)]


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
        """Log likelihood less Schwarz's price of every number, and of an arc's slant."""
        free = len(self.covariance) + sum(chart.free for chart in self.model.charts)
        price = 0.5 * np.log(self.count) * free
        return self.log_likelihood - price - self._slanted

    @property
    def _slanted(self) -> float:
        """What arcs cost that are seen aslant: seen edge on, one shows whatever moves on a line.

        The slant's tangent is as of a camera's usual turn, with Cauchy's tails.
        """
        each = zip(self.model.charts, self.geometry, strict=True)
        slants = [c.slant(g) for c, g in each if isinstance(c, Arc) and c.aslant]
        return float(sum(np.log1p((slant / USUAL_SLANT) ** 2) for slant in slants))

    @property
    def left(self) -> float:
        """Root mean square distance that the fit leaves, unit of the positions."""
        return _rms(self.residuals)

    @property
    def left_each(self) -> list[float]:
        """The same of each body."""
        bodies = len(self.model.charts)
        return [_rms(self.residuals[body::bodies]) for body in range(bodies)]

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
    def holds(self) -> bool:
        """Whether it leaves little, or nothing that lasts."""
        return self.left < GOOD * self.spread or self.errors.smooth < self.errors.white

    @property
    def driven(self) -> bool:
        """Whether its friction adds energy."""
        return self.numbers.get("linear", (0.0, 0.0))[0] < 0

    @property
    def settles(self) -> bool:
        """Whether what draws it to a place hardly makes it swing: a hand comes to rest alike."""
        law, values = self.model.law, {name: value for name, (value, _) in self.numbers.items()}
        swings = law.restoring in ("trap", "pendulum")
        return swings and bool(values.get("linear", 0.0) > law.rate(values))

    @property
    def kinds(self) -> frozenset[str]:
        """Of the law's terms; a friction that adds energy is a drive."""
        kinds = self.model.law.kinds
        return kinds - {"linear"} | {"drive"} if self.driven else kinds

    def path(self, times: np.ndarray, clip: int = -1) -> np.ndarray:
        """Places ``(t, n, d)`` at increasing seconds since the clip's first frame."""
        numbers, starts = self.model.split(self.values, len(self.clips))
        since = np.concatenate([[0.0], times]) if times[0] > 0 else times
        known = self.clips[clip].inputs
        rolled = self.model.law.roll(numbers, starts[clip], since, known)[-len(times) :, 0]
        return self.shown(rolled)

    def shown(self, s: np.ndarray) -> np.ndarray:
        """Places ``(t, n, d)`` of coordinates ``(t, k)``."""
        each = zip(self.model.charts, self.model.slices, self.geometry, strict=True)
        flat = np.stack([chart.shown(s[:, part], numbers) for chart, part, numbers in each], 1)
        camera = self.model.view(self.values)
        return flat if camera is None else view.seen(flat, camera)


def _rms(parts: Sequence[np.ndarray]) -> float:
    total = sum(float((x**2).sum()) for x in parts)
    return float(np.sqrt(total / max(sum(len(x) for x in parts), 1)))


@np.errstate(all="ignore")  # of trial numbers that fly apart: the fit takes them back
def residuals_of(
    clips: Sequence[Frames], model: Model, values: np.ndarray
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals of each clip and body ``(…, f, d)`` and each body's geometry, at its best.

    Args:
        clips: what was seen.
        model: a law and its charts.
        values: the law's numbers, then the starts of all clips, ``(…, v)``.
    """
    rolled, camera = [x[..., 0, :] for x in model.coordinates(values, clips)], model.view(values)
    geometry = [
        _geometry(clips, rolled, chart, part, body, camera)
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True))
    ]
    return missed(clips, model, rolled, geometry, camera), geometry


def missed(
    clips: Sequence[Frames],
    model: Model,
    rolled: Sequence[np.ndarray],
    geometry: Sequence[np.ndarray],
    camera: np.ndarray | None,
) -> list[np.ndarray]:
    """Residuals of each clip and body ``(…, f, d)`` of coordinates ``(…, t, k)`` that are shown by
    a geometry ``(…, g)``.
    """
    out = []
    for clip, s in zip(clips, rolled, strict=True):
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True)):
            told = chart.shown(s[..., clip.seen[body], part], geometry[body])
            told = told if camera is None else view.seen(told, camera[..., None, :])
            out.append(clip.stretches[body].places - told)
    return out


def _geometry(
    clips: Sequence[Frames],
    rolled: Sequence[np.ndarray],
    chart: Chart,
    part: slice,
    body: int,
    camera: np.ndarray | None,
) -> np.ndarray:
    """The numbers of a chart ``(…, g)`` by least squares, given the coordinates."""
    each = zip(rolled, clips, strict=True)
    s = np.concatenate([x[..., c.seen[body], part] for x, c in each], -2)
    columns = chart.columns(s)
    lead, count = columns.shape[:-3], columns.shape[-1]
    if count == 0:
        return np.zeros((*lead, 0))
    places = np.concatenate([c.stretches[body].places for c in clips])
    places = places if camera is None else view.flat(places, camera[..., None, :])
    trust = np.concatenate([c.stretches[body].trust for c in clips])
    weight = np.sqrt(trust)[:, None]
    rest = ((places - chart.fixed(s)) * weight).reshape(*lead, -1, 1)
    design = (columns * weight[..., None]).reshape(*lead, -1, count)
    return solved(design, rest)[..., 0]


def solved(design: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Least squares ``(…, g, 1)`` of many at once; 0 where a design is no number."""
    across = design.swapaxes(-1, -2)
    gram, moment = across @ design, across @ rest
    sizes = np.sqrt(gram.diagonal(axis1=-2, axis2=-1))[..., None]
    told = np.isfinite(sizes).all((-1, -2), keepdims=True)
    sizes = np.where(told & (sizes > 0), sizes, np.inf)
    unit = np.where(told, gram, 0.0) / (sizes * sizes.swapaxes(-1, -2))
    pulled = np.where(told, moment, 0.0) / sizes
    return np.linalg.solve(unit + TELLS * np.eye(gram.shape[-1]), pulled) / sizes
