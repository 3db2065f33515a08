"""A double pendulum by its weights in a picture: their places become the angles of two rods."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from vidphys.diagnose.mechanisms import view
from vidphys.diagnose.mechanisms.chain import chained
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.starts.guesses import circle_through
from vidphys.diagnose.recordings.motion import Motion

STIFF = 0.1  # of its length, by which a rod's length may vary
RIGID = 0.02  # of their distance, by which that of two that a rod joins may vary
OVER = np.pi  # radians of the upper rod's swing, beyond which it goes over the top
OFTEN = 0.5  # of the frames, in which both are seen
TELLING = 10.0  # frames of a clip that tell of a length, as a tracker's mistakes last
SOFT = 0.03  # of the upper rod: misses beyond count by their size
EVENER = 0.7  # times as uneven at most, where a camera that stands askew explains why rods seem so
ROUNDS = 2  # of finding how askew, each with what the last one left as the tracker's noise
DOWN = -np.pi / 2  # the direction from which a rod's angle counts


@dataclass(frozen=True)
class Rods:
    """Two rods end on end.

    Args:
        pivot: where the upper one hangs, ``(2,)``.
        lengths, errors: of both, and their standard errors, ``(2,)``.
        order: bodies at the end of the upper and the lower one.
        camera: how it sees the plane in which they swing, ``(3,)``; see :func:`.view.flat`.
    """

    pivot: np.ndarray
    lengths: np.ndarray
    errors: np.ndarray
    order: tuple[int, int]
    camera: np.ndarray = field(default_factory=lambda: np.zeros(len(view.NAMES)))

    def angles(self, places: np.ndarray) -> np.ndarray:
        """From hanging straight down, ``(t, 2)``, of places ``(t, 2, 2)``; NaN where unseen."""
        places = view.flat(places, self.camera)
        upper, lower = (places[:, body] for body in self.order)
        away = np.stack([upper - self.pivot, lower - upper], 1)
        turned = np.arctan2(away[..., 1], away[..., 0]) - DOWN
        out = np.full(turned.shape, np.nan)
        for rod in range(2):
            seen = np.isfinite(turned[:, rod])
            out[seen, rod] = np.unwrap(turned[seen, rod])
            out[:, rod] -= 2 * np.pi * np.round(np.nanmedian(out[:, rod]) / (2 * np.pi))
        return out

    def places(self, angles: np.ndarray) -> np.ndarray:
        """Of both bodies, ``(t, 2, 2)``, from angles ``(t, 2)``."""
        along = np.stack([np.cos(angles + DOWN), np.sin(angles + DOWN)], -1)
        upper = self.pivot + self.lengths[0] * along[:, 0]
        ends = upper, upper + self.lengths[1] * along[:, 1]
        plane = np.stack([ends[self.order.index(body)] for body in range(2)], 1)
        return view.seen(plane, self.camera)


@dataclass(frozen=True)
class RodsFit(Fit):
    """A law of angles that is shown, and misses, in a picture.

    Args:
        rods: whose angles they are.
    """

    rods: Rods

    def shown(self, s: np.ndarray) -> np.ndarray:
        return self.rods.places(super().shown(s)[..., 0])

    @cached_property
    def _paths(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Places as they were seen and as the law has them, of each clip."""
        residuals, out = iter(self.residuals), []
        for clip in self.clips:
            seen = np.concatenate([stretch.places for stretch in clip.stretches], 1)
            off = np.concatenate([next(residuals) for _ in clip.stretches], 1)
            out.append((self.rods.places(seen), self.rods.places(seen - off)))
        return out

    @property
    def left(self) -> float:
        off = np.concatenate([seen - told for seen, told in self._paths])
        return float(np.sqrt((off**2).sum(-1).mean()))

    @property
    def spread(self) -> float:
        joined = np.concatenate([seen for seen, _ in self._paths])
        return float(np.sqrt(((joined - joined.mean(0)) ** 2).sum(-1).mean()))


def rods_in_picture(motion: Motion, camera: bool) -> RodsFit | None:
    """The law of two rods whose ends are seen in a plane, if there are such rods.

    Args:
        motion: one clip of two bodies.
        camera: whether places are in a picture about whose middle they are counted, up is up.
    """
    found = []
    for rods in _candidates(motion.positions[0], camera):
        angles = rods.angles(motion.positions[0])
        fit = chained(replace(motion, positions=angles[None, :, :, None]))
        if fit is not None:
            found.append(
                RodsFit(**{name: getattr(fit, name) for name in Fit.__match_args__}, rods=rods)
            )
    # In small swings the lower weight is nearly on a circle too, but of rods it is not the law's.
    return min(found, key=lambda x: x.left, default=None)


def at_one_distance(motion: Motion) -> bool:
    """Whether two bodies of a clip go as if a rod were between them."""
    both = motion.positions[0][motion.seen[0].all(-1)]
    apart = np.linalg.norm(both[:, 1] - both[:, 0], axis=-1)
    usual = len(both) > OFTEN * motion.positions.shape[1]
    return usual and bool(np.std(apart) < RIGID * apart.mean())


def _candidates(places: np.ndarray, camera: bool) -> Iterator[Rods]:
    """Rods of nearly constant lengths, either body at the upper one's end.

    Where a camera that stands askew makes them more so, also as it sees them.
    """
    both = places[np.isfinite(places).all((-1, -2))]
    if len(both) < 2:
        return
    for order in ((0, 1), (1, 0)):
        ends = both[:, list(order)]
        centre = circle_through(ends[:, 0])
        reach = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
        if centre is None or np.std(reach) > STIFF * reach.mean():
            continue
        straight = _rods(ends, _pivot(ends[:, 0], centre), order)
        if straight is not None and (not camera or _hangs(ends, straight)):
            yield straight
            yield from _seen_askew(ends, straight) if camera else ()


def _rods(
    ends: np.ndarray, pivot: np.ndarray, order: tuple[int, int], camera: np.ndarray | None = None
) -> Rods | None:
    """Those between a pivot and their ends in a plane, ``(t, 2, 2)``, if the upper one keeps so."""
    lengths = _lengths(ends, pivot)
    if np.std(lengths[:, 0]) > STIFF * lengths[:, 0].mean():
        return None
    errors = np.std(lengths, axis=0) / np.sqrt(TELLING)
    found = Rods(pivot, np.median(lengths, axis=0), errors, order)
    return found if camera is None else replace(found, camera=camera)


def _hangs(ends: np.ndarray, rods: Rods) -> bool:
    """Whether the upper one is below its pivot; what goes over the top may be above for long."""
    away = ends[:, 0] - rods.pivot
    turned = np.ptp(np.unwrap(np.arctan2(away[:, 1], away[:, 0])))
    return bool(away[:, 1].mean() < 0 or turned > OVER)


def _lengths(ends: np.ndarray, pivot: np.ndarray) -> np.ndarray:
    """Of both rods in each frame, ``(t, 2)``."""
    upper, lower = ends[:, 0] - pivot, ends[:, 1] - ends[:, 0]
    return np.stack([np.linalg.norm(x, axis=-1) for x in (upper, lower)], 1)


def _seen_askew(ends: np.ndarray, straight: Rods) -> Iterator[Rods]:
    """The same rods before a camera under which their lengths are most alike, if it helps.

    A rod keeps its length wherever it swings. A view is slight until lengths say otherwise.
    """

    def uneven(numbers: np.ndarray) -> np.ndarray:
        lengths = _lengths(view.flat(ends, numbers[2:]), numbers[:2])
        return (lengths / lengths.mean(0) - 1).ravel()

    def off(numbers: np.ndarray, noise: float) -> np.ndarray:
        usual = numbers[2:] / view.USUAL
        return np.concatenate([uneven(numbers) / (noise * np.sqrt(TELLING)), usual])

    numbers = np.concatenate([straight.pivot, straight.camera])
    before = noise = _rms(uneven(numbers))
    for _ in range(ROUNDS if before else 0):
        numbers = least_squares(off, numbers, args=(noise,), loss="soft_l1").x
        noise = _rms(uneven(numbers))
    if noise < EVENER * before:
        found = _rods(view.flat(ends, numbers[2:]), numbers[:2], straight.order, numbers[2:])
        yield from () if found is None else (found,)


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt((x**2).mean()))


def _pivot(upper: np.ndarray, begin: np.ndarray) -> np.ndarray:
    """The centre to which distances are most alike."""

    def off(centre: np.ndarray) -> np.ndarray:
        away = np.linalg.norm(upper - centre, axis=-1)
        return away - away.mean()

    scale = SOFT * float(np.linalg.norm(upper - begin, axis=-1).mean())
    return least_squares(off, begin, loss="soft_l1", f_scale=scale).x
