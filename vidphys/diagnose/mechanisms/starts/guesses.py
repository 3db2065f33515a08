"""Where fits begin: local polynomials give speeds and accelerations, regression the numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import next_fast_len

from vidphys.diagnose.mechanisms.charts import Angle, Arc, Line, Plane
from vidphys.diagnose.mechanisms.fitted import Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law

HALVES = (2, 4, 8, 14)  # frames on each side of a local polynomial
CUBIC = 4
THIN = 0.35  # of the longer extent: a path that is wider is no line
ROUND = 0.15  # of the path's extent, by which a circle may miss it
LONGEST_RADIUS = 40.0  # extents of the path, from which an arc is a line
FINER = 8  # times the frequencies that a spectrum of so many frames has


@dataclass(frozen=True)
class Guess:
    """A model of one body with numbers to begin its fit at.

    Args:
        model: with linear friction.
        values: the law's numbers, then the starts; several.
        read: coordinates ``(t, k)`` of places ``(t, d)``, nearly.
    """

    model: Model
    values: list[np.ndarray]
    read: Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Local:
    """Coordinates, rates and accelerations ``(t, k)`` of the frames of one clip.

    ``u`` is what is known to push them, ``(t, m)``.
    """

    times: np.ndarray
    s: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def local(times: np.ndarray, s: np.ndarray, half: int, breaks: Sequence[int] = ()) -> Local:
    """By a cubic through the nearest frames of each, none of which lies beyond an impact.

    Args:
        breaks: the last frame before each impact.
    """
    ends = [0, *(b + 1 for b in breaks), len(times)]
    pieces = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True) if b - a >= CUBIC]
    parts = [_local(times[p], s[p], half) for p in pieces] or [_local(times, s, half)]
    return Local(*joined(parts, ("times", "s", "v", "a")))


def _local(times: np.ndarray, s: np.ndarray, half: int) -> Local:
    size = min(2 * half + 1, len(times))
    first = np.clip(np.arange(len(times)) - half, 0, len(times) - size)
    at = first[:, None] + np.arange(size)
    since = times[at] - times[:, None]
    scale = np.abs(since).max(1, keepdims=True)
    powers = (since / scale)[..., None] ** np.arange(min(CUBIC, size))
    found = np.linalg.pinv(powers) @ s[at]
    by = scale[:, 0, None]
    a = 2 * found[:, 2] / by**2 if size > 2 else np.zeros_like(s)
    return Local(times, found[:, 0], found[:, 1] / by, a)


def guesses(
    clips: Sequence[Frames], angles: bool, string: np.ndarray | None = None
) -> Iterator[Guess]:
    """All charts and restoring forces that one body may have, each with linear friction.

    Args:
        clips: of the body.
        angles: whether its coordinate is an angle in radians.
        string: from where the body rests to where it hangs, ``(2,)``, if that is known.
    """
    places = np.concatenate([clip.stretches[0].places for clip in clips])
    space = places.shape[1]
    if angles:
        yield from _angle(clips)
        return
    if space > 1:
        for restoring in ("none", "uniform", "trap"):
            yield _in(Plane(space), restoring, clips, lambda places: places)
        yield from _arcs(clips, places, string)
    middle = places.mean(0)
    extents, axes = np.linalg.svd(places - middle, full_matrices=False)[1:]
    if space == 1 or extents[1] < THIN * extents[0]:
        along = np.eye(1)[0] if space == 1 else axes[0] * np.sign(axes[0][np.abs(axes[0]).argmax()])
        chart = Line(tuple(along.tolist())) if space > 1 else Plane(1)
        for restoring in ("uniform", "trap") if space > 1 else ("none", "uniform", "trap"):
            yield _in(chart, restoring, clips, lambda places: places @ along[:, None])


def _in(
    chart: Plane | Line,
    restoring: str,
    clips: Sequence[Frames],
    read: Callable[[np.ndarray], np.ndarray],
) -> Guess:
    """A law of coordinates that are seen as they are."""
    s = [read(clip.stretches[0].places) for clip in clips]
    k = s[0].shape[1]
    law = Law(k, restoring, "linear", inputs=_inputs(clips))
    values = []
    for half in halves(clips):
        seen = seen_in(clips, s, half)
        values += [
            np.concatenate([numbers, *(start_of(one) for one in seen)])
            for numbers in _regressed(seen, restoring, k)
        ]
    return Guess(Model(law, (chart,)), values, read)


def seen_in(clips: Sequence[Frames], s: Sequence[np.ndarray], half: int) -> list[Local]:
    """The first body's coordinates ``(t, k)`` of each clip, with their rates."""
    out = []
    for clip, x in zip(clips, s, strict=True):
        seen = local(clip.stretches[0].times, x, half, [i.frame for i in clip.impacts])
        known = np.zeros((len(seen.times), 0))
        if clip.inputs is not None:
            known = clip.inputs.at(seen.times)
        out.append(replace(seen, u=known))
    return out


def _inputs(clips: Sequence[Frames]) -> int:
    """How many are known."""
    known = clips[0].inputs
    return 0 if known is None else known.values.shape[1]


def halves(clips: Sequence[Frames]) -> list[int]:
    """Of local polynomials, those that the clips are long enough for."""
    shortest = min(len(c.stretches[0].times) for c in clips)
    return [h for h in HALVES if 2 * h + 1 <= max(shortest // 2, 5)] or [HALVES[0]]


def joined(seen: Sequence[Local], names: Iterable[str]) -> list[np.ndarray]:
    """What is named of all clips, one after the other, ``(t, k)`` each."""
    return [np.concatenate([getattr(x, name) for x in seen]) for name in names]


def start_of(seen: Local) -> np.ndarray:
    """Place and rate at the clip's beginning, from the first frame that shows the body."""
    return np.concatenate([seen.s[0] - seen.v[0] * seen.times[0], seen.v[0]])


def _regressed(seen: Sequence[Local], restoring: str, k: int) -> list[np.ndarray]:
    """The law's numbers by least squares, and with the stiffness that the spectrum tells."""
    s, v, a, u = joined(seen, "svau")
    columns = [*np.eye(k)] if restoring != "none" else []
    design = [np.broadcast_to(axis, s.shape).ravel() for axis in columns]
    design = [(-s).ravel(), *design] if restoring == "trap" else design
    design += [(-v).ravel(), *u.T]
    found = np.linalg.lstsq(np.stack(design, 1), a.ravel(), rcond=None)[0]
    out, gains = [found], found[len(found) - u.shape[1] :]
    if restoring == "trap":
        for stiffness in ((2 * np.pi * frequency(seen)) ** 2, max(found[0], 0.0)):
            centre = s.mean(0)
            out.append(np.concatenate([[stiffness], stiffness * centre, [0.0], gains]))
    else:
        out.append(np.concatenate([found[: len(found) - 1 - len(gains)], [0.0], gains]))
    return out


def frequency(seen: Sequence[Local]) -> float:
    """The strongest frequency of the longest clip, 1/s."""
    one = max(seen, key=lambda x: x.times[-1] - x.times[0])
    even = np.linspace(one.times[0], one.times[-1], len(one.times))
    place = np.interp(even, one.times, one.s[:, int(one.s.var(0).argmax())])
    padded = next_fast_len(FINER * len(even), real=True)
    power = np.abs(np.fft.rfft(place - place.mean(), padded))
    trials = np.fft.rfftfreq(padded, float(even[1] - even[0]))
    slowest = 0.25 / (even[-1] - even[0])
    return float(trials[np.where(trials >= slowest, power, 0.0).argmax()])


def _angle(clips: Sequence[Frames]) -> Iterator[Guess]:
    """A table's angles: a pendulum about where they hang."""
    s = [clip.stretches[0].places for clip in clips]
    law, values, rests = Law(1, "pendulum", "linear", inputs=_inputs(clips)), [], []
    for half in halves(clips):
        seen = seen_in(clips, s, half)
        for swing, rest, rate, gains in _hanging(seen):
            starts = [start_of(x) - np.array([rest, 0.0]) for x in seen]
            values.append(np.concatenate([[swing, rate], gains, *starts]))
            rests.append(rest)
    rest = float(np.median(rests))
    yield Guess(Model(law, (Angle(),)), values, lambda places: places - rest)
    yield _in(Plane(1), "trap", clips, lambda places: places)


def _hanging(seen: Sequence[Local]) -> list[tuple[float, float, float, np.ndarray]]:
    """G over the length, the angle at rest, the friction and the inputs' gains, of angles."""
    s, v, a = (x.ravel() for x in joined(seen, "sva"))
    u = np.concatenate([x.u for x in seen])
    found = np.linalg.lstsq(np.column_stack([-np.sin(s), np.cos(s), -v, u]), a, rcond=None)[0]
    gains = found[3:]
    swing, rest = float(np.hypot(*found[:2])), float(np.arctan2(found[1], found[0]))
    spectral = (2 * np.pi * frequency(seen)) ** 2
    middle = float(0.5 * (s.max() + s.min()))
    wide = float(0.5 * (s.max() - s.min()))
    slow = 1 + min(wide, 2.5) ** 2 / 16  # a wide swing lasts longer
    return [(swing, rest, float(found[2]), gains), (spectral * slow**2, middle, 0.0, gains)]


def _arcs(
    clips: Sequence[Frames], places: np.ndarray, string: np.ndarray | None
) -> Iterator[Guess]:
    """A circle through the places, if there is one, and the pendulum on it."""
    if places.shape[1] != 2:
        return
    centre = circle_through(places) if string is None else places.mean(0) + string
    if centre is None:
        return
    rest = _mean_direction(places - centre)

    def read(places: np.ndarray) -> np.ndarray:
        away = places - centre
        turned = np.stack([away @ rest, away @ np.array([-rest[1], rest[0]])], -1)
        return np.unwrap(np.arctan2(turned[:, 1], turned[:, 0]))[:, None]

    angles = [read(clip.stretches[0].places) for clip in clips]
    law, values, rests = Law(1, "pendulum", "linear"), [], []
    for half in halves(clips):
        seen = seen_in(clips, angles, half)
        for swing, hangs, rate, _ in _hanging(seen):
            starts = [start_of(x) - np.array([hangs, 0.0]) for x in seen]
            values.append(np.concatenate([[max(swing, 1e-6), rate], *starts]))
            rests.append(hangs)
    hanging = float(np.median(rests))
    for aslant in (False, True):
        yield Guess(Model(law, (Arc(aslant),)), values, lambda places: read(places) - hanging)


def _mean_direction(away: np.ndarray) -> np.ndarray:
    """The middle of the directions that occur, of length one."""
    mean = (away / np.linalg.norm(away, axis=1, keepdims=True)).mean(0)
    size = np.linalg.norm(mean)
    return mean / size if size > 1e-9 else np.array([0.0, -1.0])


def circle_through(places: np.ndarray) -> np.ndarray | None:
    """Centre by least squares (Kasa 1976), if a circle comes near the places."""
    middle = places.mean(0)
    x = places - middle
    extent = float(np.sqrt((x**2).sum(1).mean()))
    if extent <= 0:
        return None
    design = np.column_stack([2 * x, np.ones(len(x))])
    found = np.linalg.lstsq(design, (x**2).sum(1), rcond=None)[0]
    squared = found[2] + found[:2] @ found[:2]
    if not squared > 0:
        return None
    radius = float(np.sqrt(squared))
    miss = np.sqrt(np.mean((np.linalg.norm(x - found[:2], axis=1) - radius) ** 2))
    if miss > ROUND * extent or radius > LONGEST_RADIUS * extent:
        return None
    return middle + found[:2]
