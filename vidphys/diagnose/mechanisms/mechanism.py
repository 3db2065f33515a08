"""What moves the bodies of a recording: each by a law of its own, or several by one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vidphys.diagnose.mechanisms.chain import chained, linked
from vidphys.diagnose.mechanisms.choose import fits_of, roughly
from vidphys.diagnose.mechanisms.coupled import CLEARLY, coupled
from vidphys.diagnose.mechanisms.fit import fit
from vidphys.diagnose.mechanisms.fitted import GOOD, Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames, frames_of, spread_of
from vidphys.diagnose.mechanisms.impacts.collisions import colliding, parties
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.ranking import LIKELIER, ranked
from vidphys.diagnose.mechanisms.rods import rods_in_picture
from vidphys.diagnose.mechanisms.sense import makes_sense
from vidphys.diagnose.mechanisms.starts.orbits import orbiting
from vidphys.diagnose.mechanisms.uncertainty import restricted
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

MOST_CLIPS, MOST_BODIES = 8, 4
MOST_FRAMES = 1500
RIVALS = 15.0  # of log likelihood, within which all frames choose between laws
WORSE = 3.0  # times what a fit left, from which all frames belong to no one law
NEAR_BEST = 2.0  # times the least that is left from any first frame
ENOUGH = 0.55  # of the frames that a law was fitted to, by which it is found again
LASTS = 2.0  # times the errors of single frames, from which an error lasts that a law leaves
LATER = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)  # of the frames: where a law is tried to hold from


@dataclass(frozen=True)
class Group:
    """Bodies that one law moves.

    Args:
        bodies: their numbers.
        fit: of the law.
        others: other laws that were fitted to them, best first.
    """

    bodies: tuple[int, ...]
    fit: Fit
    others: tuple[Fit, ...] = ()


@dataclass(frozen=True)
class Mechanism:
    """Laws of all bodies.

    Args:
        groups: of bodies, each with its law.
        first: frame from which the laws hold; a hand may have held a body before.
        begin: seconds of that frame, of each clip's own time.
    """

    groups: tuple[Group, ...]
    first: int
    begin: np.ndarray

    @property
    def kinds(self) -> frozenset[str]:
        """Of all terms."""
        return frozenset().union(*(group.fit.kinds for group in self.groups))

    @property
    def windowed(self) -> bool:
        """Whether its numbers are from short windows, each with a start of its own."""
        return self.groups[0].fit.model.law.restoring == "chain"

    @property
    def left(self) -> float:
        """Root mean square distance that the laws leave, unit of the positions."""
        return float(np.sqrt(np.mean([group.fit.left**2 for group in self.groups])))

    @property
    def spread(self) -> float:
        """The same of bodies that would stand at their means."""
        return float(np.sqrt(np.mean([group.fit.spread**2 for group in self.groups])))

    @property
    def share(self) -> float:
        """Of the motion, that the laws explain: 1 less what is left of its variance."""
        return 1 - (self.left / self.spread) ** 2

    def refitted(self, motion: Motion) -> tuple[Mechanism, Mechanism]:
        """With numbers from all frames from the first one that the laws hold at.

        Of laws that the fitted frames do not tell apart, all frames choose.

        Returns:
            The chosen laws with their numbers as they are, and with those from all frames.
        """
        if self.windowed:
            return self, self  # of windows, which frames that were held out do not lengthen
        rest = thinned(motion.cut(self.first))
        pairs = [_refitted(frames_of(rest.of(group.bodies)), group) for group in self.groups]
        few, all_ = (tuple(groups) for groups in zip(*pairs, strict=True))
        return replace(self, groups=few), replace(self, groups=all_)

    def by_frames_before(self, times: np.ndarray) -> Mechanism | None:
        """The same laws with numbers from the frames before a time of each clip ``(e,)``.

        ``None`` where these are too few, or hardly half of those that the laws were fitted to, or
        show none of a body's bounces.
        """
        since = (times[-1] if self.windowed else times) - self.begin
        kept = np.all([_enough(group.fit, since) for group in self.groups], axis=0)
        if not (kept.any() if self.windowed else kept.all()):
            return None
        fits = [_again(group.fit, since, kept) for group in self.groups]
        groups = [replace(x, fit=y) for x, y in zip(self.groups, fits, strict=True) if y]
        return replace(self, groups=tuple(groups), begin=self.begin[kept]) if all(fits) else None

    def path(self, times: np.ndarray, clip: int = -1) -> np.ndarray:
        """Places ``(t, n, d)`` at times of the clip, not before the laws hold."""
        since = times - self.begin[clip]
        parts = {b: i for group in self.groups for i, b in enumerate(group.bodies)}
        rolled = {group.bodies: group.fit.path(since, clip) for group in self.groups}
        whose = {b: group.bodies for group in self.groups for b in group.bodies}
        return np.stack([rolled[whose[b]][:, parts[b]] for b in sorted(whose)], 1)


def _before(clips: Sequence[Frames], since: np.ndarray) -> list[Frames]:
    """Of each clip the frames before so many seconds."""
    each = zip(clips, since, strict=True)
    return [clip.upto(int(np.searchsorted(clip.times, seconds))) for clip, seconds in each]


def _enough(found: Fit, since: np.ndarray) -> list[bool]:
    """Whether so many seconds of each clip are enough of it to tell its law again."""
    pairs = [*zip(_before(found.clips, since), found.clips, strict=True)]
    bounces = bool(found.model.law.walls) and len(found.model.charts) == 1
    return [
        all(
            len(x.times) >= max(LEAST_FRAMES, ENOUGH * len(y.times))
            for x, y in zip(few.stretches, whole.stretches, strict=True)
        )
        and not (bounces and _bounces_later(few, whole))
        for few, whole in pairs
    ]


def _bounces_later(few: Frames, whole: Frames) -> bool:
    """Whether a body bounces only after the first few of its frames, or at their very end."""
    ends = [impact.frame + impact.side for impact in whole.impacts]
    return bool(ends) and min(ends) >= len(few.stretches[0].times)


def _again(found: Fit, since: np.ndarray, kept: np.ndarray) -> Fit | None:
    """The same law with its numbers from so many seconds of those of its clips that are kept."""
    numbers, starts = found.model.split(found.values, len(found.clips))
    some = [clip for clip, keep in zip(_before(found.clips, since), kept, strict=True) if keep]
    again = fit(some, found.model, np.concatenate([numbers, starts[kept].ravel()]))
    told = {name: getattr(again, name) for name in Fit.__match_args__} if again else {}
    return replace(found, **told) if again else None


def _refitted(clips: Sequence[Frames], group: Group) -> tuple[Group, Group]:
    """With the law that all frames choose: its numbers as they are, and from all frames."""
    near = [x for x in group.others if x.score > group.fit.score - RIVALS]
    near += _with_drag(group.fit)
    fitted = [(x, fit(clips, x.model, x.values)) for x in (group.fit, *near)]
    good = [(few, x) for few, x in fitted if x is not None and x.left < WORSE * few.left]
    if not good:
        return group, group
    order = ranked([x for _, x in good if makes_sense(x)] or [good[0][1]])
    few = next(few for few, x in good if x is order[0])
    others = tuple(x for x in (group.fit, *group.others) if x is not few)
    return Group(group.bodies, few, others), Group(
        group.bodies, restricted(order[0]), tuple(order[1:])
    )


def _with_drag(found: Fit) -> list[Fit]:
    """The law of a fall or a toss in a table with a drag too, which few frames may not tell of.

    In a picture a lens bends a path as much.
    """
    law = found.model.law
    bare = isinstance(law, Law) and law.restoring == "uniform" and law.friction == "none"
    if not bare or law.pictured or law.walls or law.curve is not None:
        return []
    fits = []
    for friction in ("linear", "square"):
        dragged = replace(law, friction=friction)
        values = np.insert(found.values, dragged.names.index(friction), 0.0)
        fits.append(fit(found.clips, Model(dragged, found.model.charts), values))
    return [x for x in fits if x is not None]


def find_mechanism(motion: Motion, angles: bool = False, camera: bool = False) -> Mechanism | None:
    """The likeliest laws of a recording's bodies, each body by itself unless they are coupled.

    Args:
        motion: few clips of few bodies.
        angles: whether the coordinates are angles in radians.
        camera: whether places are in a picture, counted from its middle.
    """
    if motion.clips > MOST_CLIPS or motion.bodies > MOST_BODIES:
        return None
    stride, whole = _stride(motion), motion
    motion = thinned(motion)
    first, groups = 0, _groups(motion, angles, camera)
    if groups is None or not all(g.fit.holds for g in groups if len(g.bodies) == 1):
        later = first_lawful(whole, angles) // stride
        found = _groups(motion.cut(later), angles, camera) if later else None
        if found is not None and all(group.fit.holds for group in found):
            first, groups = later, found
    if groups is None:
        return None
    begin = motion.times[:, first].copy()
    if groups[0].fit.model.law.restoring == "chain":
        begin = motion.times[-1, 0] + np.array([clip.begin for clip in groups[0].fit.clips])
    return Mechanism(groups, first * stride, begin)


def thinned(motion: Motion) -> Motion:
    """Fewer frames of a long recording, as many as a fit needs."""
    step = _stride(motion)
    if step == 1:
        return motion
    return replace(
        motion,
        positions=motion.positions[:, ::step],
        times=motion.times[:, ::step],
        ahead=None if motion.ahead is None else motion.ahead[:, ::step],
    )


def _stride(motion: Motion) -> int:
    return max(1, motion.positions.shape[1] // MOST_FRAMES)


def _groups(motion: Motion, angles: bool, camera: bool) -> tuple[Group, ...] | None:
    if motion.bodies == 2 and (angles or (motion.clips == 1 and motion.space == 2)):
        rods = chained(motion) if angles else rods_in_picture(motion, camera)
        if rods is not None and linked(rods, angles):
            return (Group((0, 1), rods),)
    groups = [] if angles else meeting(motion, camera)
    met = {body for group in groups for body in group.bodies}
    around = [] if angles or met else orbiting(frames_of(motion), camera)
    for body in range(motion.bodies):
        if body in met:
            continue
        clips = _each_alone(motion.of([body]))
        if clips is None:
            return None
        fits = fits_of(clips[0], angles, camera, motion.bodies == 1)
        if not fits:
            return _all(motion, around)
        groups.append(Group((body,), fits[0], tuple(fits[1:])))
    if motion.bodies > 1 and not met:
        laws = [(group.fit, *group.others) for group in groups]
        if around and around[0].score > sum(own[0].score for own in laws) + CLEARLY:
            return _all(motion, around)
        joint = coupled(frames_of(motion), laws, camera)
        if joint:
            return _all(motion, joint)
    return tuple(groups)


def _all(motion: Motion, fits: Sequence[Fit]) -> tuple[Group, ...] | None:
    """All bodies by the first of some laws, if there are any."""
    return (Group(tuple(range(motion.bodies)), fits[0], tuple(fits[1:])),) if fits else None


def meeting(motion: Motion, camera: bool) -> list[Group]:
    """Bodies that meet each other, and then go on by the law of collisions.

    The likeliest law holds, or one that is nearly as likely: what may be left is a round figure.
    """
    groups = []
    for party in parties(frames_of(motion)) if motion.bodies > 1 else []:
        fits = colliding(frames_of(motion.of(party)), camera)
        if any(x.holds for x in fits if x.score > fits[0].score - LIKELIER):
            groups.append(Group(party, fits[0], tuple(fits[1:])))
    return groups


def first_lawful(motion: Motion, angles: bool) -> int:
    """The first later frame from which a law holds for each body; 0 where there is none.

    Args:
        motion: one clip of few bodies; of others no such frame is sought.
        angles: whether the coordinates are angles in radians.
    """
    tried = list(lawful_from(motion, angles))
    least = min((left for _, left in tried), default=np.inf)
    return min((first for first, left in tried if left <= NEAR_BEST * least), default=0)


def lawful_from(motion: Motion, angles: bool) -> Iterator[tuple[int, float]]:
    """Frames from which a law holds for each body, the latest first, and what the laws leave.

    Which of them is the first lawful one takes far longer to tell.
    """
    if motion.clips > 1 or motion.bodies > MOST_BODIES or not motion.moves:
        return
    stride, motion = _stride(motion), thinned(motion)
    total = motion.positions.shape[1]
    like: list[list[Fit]] = [[]] * motion.bodies
    tried: list[list[Fit]] = [[]] * motion.bodies
    for share in reversed(LATER):
        first = int(share * total)
        clips = _each_alone(motion.cut(first)) if total - first >= LEAST_FRAMES + 2 else None
        if clips is None:
            continue
        if any(_none_before(*pair) for pair in zip(tried, clips, strict=True)):
            return
        held = []
        for body, frames in enumerate(clips):
            tried[body] = roughly(frames, angles, like[body])
            held.append([x for x in tried[body] if x.holds])
            if not held[-1]:
                break
        else:
            yield stride * first, max(min(x.left for x in laws) for laws in held)
            like = held  # a law that holds from a frame on holds from a later one too


def first_alone(motion: Motion) -> bool:
    """Whether a law of the first body by itself comes near, or too little of it is seen to tell."""
    clips = _each_alone(thinned(motion).of([0]))
    return clips is None or any(law.holds for law in roughly(clips[0], angles=False))


def _each_alone(motion: Motion) -> list[list[Frames]] | None:
    """Frames of each body; ``None`` where too little of one is seen."""
    clips = [frames_of(motion.of([body])) for body in range(motion.bodies)]
    fewest = min(len(clip.stretches[0].times) for each in clips for clip in each)
    return clips if fewest >= LEAST_FRAMES else None


def _none_before(tried: Sequence[Fit], clips: Sequence[Frames]) -> bool:
    """Whether laws left so much of the last frames that none can hold for these, which end alike:
    it would leave no less of the same frames.
    """
    if not tried or any(x.errors.smooth < LASTS * x.errors.white for x in tried):
        return False
    squared = min(x.left**2 * len(x.clips[0].stretches[0].times) for x in tried)
    most = GOOD * spread_of(clips)
    return squared > most**2 * len(clips[0].stretches[0].times)
