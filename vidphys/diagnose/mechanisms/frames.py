"""What was seen in the clips of a recording, body by body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vidphys.diagnose.mechanisms.impacts.kinks import Impact, find_impacts
from vidphys.diagnose.mechanisms.measurement import Stretch
from vidphys.diagnose.recordings.inputs import Signal
from vidphys.diagnose.recordings.motion import Motion


@dataclass(frozen=True)
class Frames:
    """What was seen in one clip.

    Args:
        times: of all frames, seconds from the clip's first, ``(t,)``.
        seen: frames in which each body was seen, of each body ``(f,)``.
        stretches: of each body, at those frames.
        begin: seconds from the recording's first frame to the first of these.
        inputs: what drives the bodies and is known, by the seconds since the clip's first frame.
        spin_fades: share a second by which the spin of a body that is seen to spin fades.
        ahead: places of the first body in later frames that are held out, ``(h, d)``.
    """

    times: np.ndarray
    seen: tuple[np.ndarray, ...]
    stretches: tuple[Stretch, ...]
    begin: float = 0.0
    inputs: Signal | None = None
    spin_fades: float | None = None
    ahead: np.ndarray | None = None

    @cached_property
    def impacts(self) -> list[Impact]:
        """Of the first body."""
        return find_impacts(self.stretches[0].times, self.stretches[0].places)

    def of(self, body: int) -> Frames:
        """What was seen of one body alone."""
        return replace(self, seen=(self.seen[body],), stretches=(self.stretches[body],))

    def upto(self, count: int) -> Frames:
        """The first frames."""
        few = [int((seen < count).sum()) for seen in self.seen]
        return Frames(
            self.times[:count],
            tuple(seen[:n] for seen, n in zip(self.seen, few, strict=True)),
            tuple(x.upto(n) for x, n in zip(self.stretches, few, strict=True)),
            self.begin,
            self.inputs,
            self.spin_fades,
            self.ahead,
        )

    def thinned(self, step: int) -> Frames:
        """One of so many frames."""
        kept = [np.flatnonzero(seen % step == 0) for seen in self.seen]
        each = zip(self.seen, self.stretches, kept, strict=True)
        seen, stretches = zip(*((s[rows] // step, x.at(rows)) for s, x, rows in each), strict=True)
        return replace(self, times=self.times[::step], seen=seen, stretches=stretches)


def thinned_to(clips: Sequence[Frames], most: int) -> list[Frames]:
    """Clips of about so many frames where the first has more."""
    step = max(1, len(clips[0].times) // most)
    return [clip.thinned(step) for clip in clips]


def frames_of(motion: Motion) -> list[Frames]:
    """The frames of each clip in which its bodies were seen."""
    clips = []
    known = motion.inputs or (None,) * motion.clips
    recorded = zip(motion.positions, motion.seen, motion.times, known, strict=True)
    for clip, (path, seen, times, signal) in enumerate(recorded):
        at = [np.flatnonzero(of_body) for of_body in seen.T]
        since = times - times[0]
        stretches = tuple(
            Stretch(since[i], path[i, body], np.ones(len(i))) for body, i in enumerate(at)
        )
        signal = None if signal is None else signal.since(float(times[0]))
        later = None if motion.ahead is None else motion.ahead[clip, :, 0]
        ahead = None if later is None else later[np.isfinite(later).all(-1)]
        clips.append(Frames(since, tuple(at), stretches, 0.0, signal, motion.spin_fades, ahead))
    return clips


def spread_of(clips: Sequence[Frames]) -> float:
    """Size of the motion, unit of the positions."""
    parts = [s.places.var(0).sum() for clip in clips for s in clip.stretches if len(s.places)]
    return max(float(np.sqrt(np.mean(parts))), np.finfo(float).tiny)
