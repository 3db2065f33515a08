"""A law with its charts, what it misses of a recording, and how well its numbers are known."""

from __future__ import annotations

from collections import deque
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
KEPT = 3  # rolls of each clip: a fit's own, and those a step of a derivative up and down
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
        """The law's numbers, and the starts ``(clips, 2, k)``."""
        count = len(self.law.names)
        return values[:count], values[count:].reshape(clips, 2, self.law.coordinates)

    def view(self, values: np.ndarray) -> np.ndarray | None:
        """How a camera sees the plane of motion, ``(3,)``; ``None`` where none does."""
        if not self.law.pictured:
            return None
        count = len(self.law.names)
        return values[count - len(view.NAMES) : count]

    def coordinates(self, values: np.ndarray, clips: Sequence[Frames]) -> list[np.ndarray]:
        """Coordinates and rates of every frame of each clip, ``(t, 2, k)``."""
        numbers, starts = self.split(values, len(clips))
        if len(clips) == 1:
            return [self.law.roll(numbers, starts[0], clips[0].times, clips[0].inputs)]
        each = enumerate(zip(clips, starts, strict=True))
        return [self._rolled(number, clip, numbers, start) for number, (clip, start) in each]

    def _rolled(
        self, number: int, clip: Frames, numbers: np.ndarray, start: np.ndarray
    ) -> np.ndarray:
        """One clip's; a derivative by the start of another asks for the same again."""
        latest = self._kept.setdefault(number, deque(maxlen=KEPT))
        asked = numbers.tobytes() + start.tobytes()
        for known, of, rolled in latest:
            if known == asked and of is clip:
                return rolled
        rolled = self.law.roll(numbers, start, clip.times, clip.inputs)
        rolled.flags.writeable = False
        latest.appendleft((asked, clip, rolled))
        return rolled

    @cached_property
    def _kept(self) -> dict[int, deque[tuple[bytes, Frames, np.ndarray]]]:
        """What was rolled last of each clip."""
        return {}


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
        return swings and values.get("linear", 0.0) > law.rate(values)

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
    """Residuals of each clip and body ``(f, d)`` and each body's geometry, at its best."""
    rolled, camera = [x[:, 0] for x in model.coordinates(values, clips)], model.view(values)
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
    """Residuals of each clip and body ``(f, d)`` of coordinates ``(t, k)`` shown by a geometry."""
    out = []
    for clip, s in zip(clips, rolled, strict=True):
        for body, (chart, part) in enumerate(zip(model.charts, model.slices, strict=True)):
            told = chart.shown(s[clip.seen[body], part], geometry[body])
            told = told if camera is None else view.seen(told, camera)
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
    """The numbers of a chart by least squares, given the coordinates."""
    s = np.concatenate([x[c.seen[body], part] for x, c in zip(rolled, clips, strict=True)])
    columns = chart.columns(s)
    if columns.shape[-1] == 0 or not np.isfinite(columns).all():
        return np.zeros(columns.shape[-1])
    places = np.concatenate([c.stretches[body].places for c in clips])
    places = places if camera is None else view.flat(places, camera)
    trust = np.concatenate([c.stretches[body].trust for c in clips])
    weight = np.sqrt(trust)[:, None]
    rest = (places - chart.fixed(s)) * weight
    design = (columns * weight[..., None]).reshape(-1, columns.shape[-1])
    return np.linalg.lstsq(design, rest.ravel(), rcond=None)[0]
