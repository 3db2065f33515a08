"""Two rods that hang end on end, by their angles: a double pendulum.

Its motion may be chaotic, so that no start leads through the whole recording: the law's numbers are
fitted to several short windows, each with a start of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.charts import Angle
from vidphys.diagnose.mechanisms.fit import fit
from vidphys.diagnose.mechanisms.fitted import GOOD, Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames, frames_of
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.ranking import ranked
from vidphys.diagnose.mechanisms.starts.guesses import joined, local
from vidphys.diagnose.mechanisms.uncertainty import restricted
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

WINDOWS = (2, 6)  # of a recording, at least and at most
RADIANS = 4.0  # that a window's angles turn through, about
LONGEST = 150  # frames of a window
SHOWN = 0.7  # of a window's frames, in which all is seen
HALVES = (2, 4, 8)  # frames on each side of a local polynomial
SMALL = 1e-3
# standard errors, by which the link between two rods is there: by their angles alone; and by two
# weights in a picture, that keep their distance
SURELY, AS_SEEN = 10.0, 4.0
# standard errors, by which friction is there: they are too small, as windows share frames, and in
# clips filmed for development up to 7 were seen where there was none
RUBS = 8.0
ROUGHLY = 0.06  # of the spread, that the law of such weights leaves at most whose link is sure


def chained(motion: Motion) -> Fit | None:
    """The law of two rods, if it can be fitted.

    Args:
        motion: two angles in radians, seen in most frames.
    """
    rate = float(np.sqrt(np.nanmean(np.diff(motion.positions, axis=1) ** 2))) or 1.0
    size = int(np.clip(RADIANS / rate, LEAST_FRAMES, min(LONGEST, motion.positions.shape[1])))
    clips = _windows(motion, size)
    if not clips:
        return None
    found = []
    for half in HALVES:
        numbers, rests = _regressed(motion, half)
        starts = [_start(clip, rests, half) for clip in clips]
        for friction in ("linear", "none"):
            model = Model(Law(2, "chain", friction, apart=True), (Angle(), Angle()))
            own = numbers[: len(model.law.names)]
            found.append(fit(clips, model, np.concatenate([own, *starts])))
    likely = ranked([x for x in found if x is not None and not x.driven and _rubs_surely(x)])
    return restricted(likely[0]) if likely else None


def _rubs_surely(rods: Fit) -> bool:
    """Whether its friction, if it has one, is there."""
    rate, error = rods.numbers.get("linear", (1.0, 0.0))
    return rate > RUBS * error


def linked(rods: Fit, angles: bool) -> bool:
    """Whether it is the law, and each rod feels the other.

    Args:
        rods: their law.
        angles: whether these were recorded; else the weights were seen in a picture.
    """
    link, error = rods.numbers["link"]
    if angles:
        return rods.holds and link > SURELY * error
    most = GOOD if link < SURELY * error else ROUGHLY
    return rods.left < most * rods.spread and link > AS_SEEN * error


def _windows(motion: Motion, size: int) -> list[Frames]:
    """Some over the recording, in which all is seen mostly; the last of them as late as it is."""
    spots = []
    for number, seen in enumerate(np.all(motion.seen, axis=-1)):
        for long in range(size, LEAST_FRAMES - 1, -1):
            shown = np.convolve(seen, np.ones(long, int), "valid")
            least = max(LEAST_FRAMES, SHOWN * long)
            whole = np.flatnonzero(seen[: len(shown)] & (shown >= least))
            if len(whole):
                most = int(np.clip(len(seen) // long, *WINDOWS))  # that share no frames, or few
                some = np.linspace(0, len(whole) - 1, most).astype(int)
                spots += [(int(first), number, long) for first in np.unique(whole[some])]
                break
    out = []
    for first, number, long in sorted(spots):
        part = motion.take(np.array([number])).cut(first, first + long)
        places = part.positions.copy()
        places[~part.seen.all(-1)] = np.nan
        clip = frames_of(replace(part, positions=places))[0]
        begin = float(motion.times[number, first] - motion.times[number, 0])
        out.append(replace(clip, begin=begin))
    return out


def _regressed(motion: Motion, half: int) -> tuple[np.ndarray, np.ndarray]:
    """The law's numbers, and where the rods hang, by least squares on accelerations."""
    parts = []
    for path, times, seen in zip(motion.positions, motion.times, motion.seen, strict=True):
        at = seen.all(-1)
        parts.append(local(times[at], path[at, :, 0], half))
    (s1, s2), (v1, v2), (a1, a2) = (x.T for x in joined(parts, "sva"))
    d = s1 - s2
    first = np.stack([-np.cos(d) * a2 - np.sin(d) * v2**2, -np.sin(s1), np.cos(s1), -v1], 1)
    link, down1, aside1, rate = np.linalg.lstsq(first, a1, rcond=None)[0]
    second = np.stack([-np.cos(d) * a1 + np.sin(d) * v1**2, -np.sin(s2), np.cos(s2), -v2], 1)
    over, down2, aside2, _ = np.linalg.lstsq(second, a2, rcond=None)[0]
    inertia = float(link / over) if link > 0 and over > 0 else 1.0
    link = float(np.clip(link, SMALL, 0.95 * np.sqrt(inertia)))
    swings = np.hypot(down1, aside1), inertia * np.hypot(down2, aside2)
    rests = np.array([np.arctan2(aside1, down1), np.arctan2(aside2, down2)])
    return np.array([*swings, link, inertia, max(float(rate), 0.0)]), rests


def _start(clip: Frames, rests: np.ndarray, half: int) -> np.ndarray:
    places = np.concatenate([x.places for x in clip.stretches], 1)
    seen = local(clip.stretches[0].times, places, half)
    return np.concatenate([seen.s[0] - rests, seen.v[0]])
