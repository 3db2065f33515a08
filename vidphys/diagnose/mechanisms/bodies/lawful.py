"""Which of the things that were followed in a clip are bodies that a law moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from vidphys.diagnose.mechanisms.bodies.extents import (
    LITTLE,
    not_at_rest,
    seen_enough,
    settled,
    shown_enough,
    stay,
    stays_on,
)
from vidphys.diagnose.mechanisms.bodies.let_go import MOST_TRIED, lawful_later, released
from vidphys.diagnose.mechanisms.bodies.passers import passes_by, turns_back
from vidphys.diagnose.mechanisms.bodies.shadows import goes_with, without_shadows
from vidphys.diagnose.mechanisms.chain import linked
from vidphys.diagnose.mechanisms.choose import pictured, roughly
from vidphys.diagnose.mechanisms.coupled import coupled
from vidphys.diagnose.mechanisms.fitted import GOOD, Fit
from vidphys.diagnose.mechanisms.frames import Frames, frames_of
from vidphys.diagnose.mechanisms.mechanism import meeting, thinned
from vidphys.diagnose.mechanisms.rods import at_one_distance, rods_in_picture
from vidphys.diagnose.recordings.motion import Motion
from vidphys.diagnose.recordings.parted import parted

ASKEW = 0.15  # of the spread: what a law leaves before the camera's view is set right
STRAIGHTENED = 0.05  # of the spread: the same after it, of a body whose ends are often cut
JUMPY = 0.2  # of the spread: noise, beyond which no law is seen to move a body
MUCH_LESS = 0.5  # of what two bodies' own laws leave, that springs between them leave
FAR_LESS = 0.3  # of what two rods leave, that a law of one weight by itself leaves


def of_lawful_bodies(motion: Motion) -> tuple[Motion, tuple[str, ...]]:
    """The motion of bodies that a law moves, where there are such beside others; else of all.

    A hand, a shadow or a face is followed as well as a ball, but moves by no law.

    Args:
        motion: of what was followed in a clip.

    Returns:
        The motion, and what a person should know of those that were left out.
    """
    alone, shadows = without_shadows(motion)
    chain = _chain(motion)
    if chain:
        return motion.of(chain), _said(motion.bodies, len(chain))
    if len(alone) == 1:
        return motion.of(alone), shadows
    motion = motion.of(alone)
    going = _without_passers(motion)
    if len(going) < motion.bodies:
        kept, found, _ = _lawful_of(motion.of(going))
        if found:
            return kept.of(found), (*shadows, *_said(motion.bodies, len(found)))
    kept, found, nearly = _lawful_of(motion)
    both = motion.bodies == 2 and len(seen_enough(motion, not_at_rest(motion, [0, 1]))) == 2
    if both and not found:
        return kept, shadows  # of two that no law moves alone, each may move the other
    found, nearly = (
        [body for body in some if body in going or not turns_back(motion, body)]
        for some in (found, nearly)
    )
    found = found or nearly or not_at_rest(motion, going)[:1]  # the binder's likeliest
    return kept.of(found), (*shadows, *_said(motion.bodies, len(found)))


def _pairs(motion: Motion) -> list[list[int]]:
    """Of the likeliest bodies, and what goes as if a rod were between them."""
    return [
        list(pair)
        for pair in combinations(range(motion.bodies), 2)
        if max(pair) < MOST_TRIED or at_one_distance(motion.of(pair))
    ]


def _chain(motion: Motion) -> list[int]:
    """The ends of two rods, from the pivot on, if there are such.

    In its slow swing one weight of a double pendulum moves in proportion to the other, as a shadow
    does, but a shadow pulls at nothing. No weight swings far better by itself than on two rods, and
    none that moves so swings better at all.
    """
    for pair in _pairs(motion):
        rods = rods_in_picture(motion.of(pair), camera=True)
        if rods is not None and linked(rods, angles=False):
            share = 1.0 if goes_with(motion, *pair) else FAR_LESS
            most = share * rods.left / rods.spread
            if all(_least_left(motion, body) > most for body in pair):
                return [pair[end] for end in rods.rods.order]
    return []


def _least_left(motion: Motion, body: int) -> float:
    """What the best law of a body by itself leaves, as a share of its spread."""
    laws = roughly(_clips(motion, [body]), angles=False) if shown_enough(motion, body) else []
    return min((law.left / law.spread for law in laws), default=np.inf)


def _without_passers(motion: Motion) -> list[int]:
    """Those that do not only pass by; all where there are no others, or where they meet."""
    passing = {body for body in range(motion.bodies) if passes_by(motion, body)}
    if passing and len(passing) < motion.bodies:
        passing -= {
            body for group in meeting(thinned(motion), camera=True) for body in group.bodies
        }
    going = [body for body in range(motion.bodies) if body not in passing]
    return going or list(range(motion.bodies))


def _lawful_of(motion: Motion) -> tuple[Motion, list[int], list[int]]:
    """The bodies that a law moves, of things of which none is another's shadow.

    Returns:
        The motion, mended where they touch; the bodies; and those that a law nearly moves.
    """
    followed, motion = motion, parted(motion)
    met = [body for group in meeting(thinned(motion), camera=True) for body in group.bodies]
    laws, lawful = _laws(motion, met)
    staying = {body: laws[body] for body in _followed_on(followed, list(laws)[:MOST_TRIED])}
    lawful = _or_likelier(motion, sorted({*lawful, *_tied(motion, staying, lawful)}), laws)
    if not met and not stay(motion, lawful):
        let_go = _or_likelier(followed, released(followed, lawful), laws)
        if let_go:
            return followed, let_go, []
    found = met + seen_enough(motion, lawful)
    for pair in _pairs(motion):
        if set(pair) & set(found) and at_one_distance(motion.of(pair)):
            found = [*found, *(set(pair) - set(found))]  # a rod may join them
    found = sorted(found)
    nearly = [body for body in laws if _nearly(laws[body])]
    nearly = not_at_rest(motion, seen_enough(motion, nearly))
    if _needs_no_mending(followed, motion, found):
        motion = followed
    return motion, found, nearly


def _followed_on(motion: Motion, bodies: list[int]) -> list[int]:
    """Those that are seen in most frames, and in nearly all from their first on."""
    return seen_enough(motion, [body for body in bodies if stays_on(motion, body)])


def _laws(motion: Motion, met: list[int]) -> tuple[dict[int, list[Fit]], list[int]]:
    """The laws of the likeliest bodies, of all where those move none; and the bodies they move.

    What hardly moves beside another is a hand that comes to rest, and moved by no law.

    Args:
        met: those that are known already.
    """
    laws: dict[int, list[Fit]] = {}
    lawful: list[int] = []
    for body in (body for body in range(motion.bodies) if body not in met):
        if len(laws) >= MOST_TRIED and (met or lawful):
            break
        if shown_enough(motion, body):
            clips = _clips(motion, [body])
            laws[body] = roughly(clips, angles=False)
            lawful += [body] if _lawful(clips, laws[body]) else []
    moving = [body for body in lawful if not settled(motion, body)]
    return laws, not_at_rest(motion, moving or lawful)


def _or_likelier(motion: Motion, found: list[int], laws: Mapping[int, Sequence[Fit]]) -> list[int]:
    """Bodies, or a likelier one that a law nearly moves and that goes far farther than they do.

    Some law fits whatever only drifts.
    """
    for body in (body for body in laws if body < min(found, default=0) and _nearly(laws[body])):
        if not_at_rest(motion, [body, *found], LITTLE) == [body]:
            return [body]
    return found


def _needs_no_mending(followed: Motion, motion: Motion, found: list[int]) -> bool:
    """Whether a law moves the one body, if only later, with the frames that mending took from it.

    What it touches in these may be a hand that lets go of it.
    """
    if len(found) != 1 or followed.of(found).seen.sum() <= motion.of(found).seen.sum():
        return False
    clips = _clips(followed, found)
    return _lawful(clips, roughly(clips, angles=False)) or lawful_later(followed, found[0])


def _clips(motion: Motion, bodies: list[int]) -> list[Frames]:
    """The frames in which these are seen."""
    some = motion.of(bodies)
    first, last = some.shown()
    return frames_of(thinned(some.cut(first, last)))


def _said(all_: int, looked_at: int) -> tuple[str, ...]:
    """What a person should know, if anything."""
    if looked_at == all_:
        return ()
    return (f"{all_} things move; {looked_at} of them are looked at, as bodies of the scene",)


def _tied(motion: Motion, laws: Mapping[int, Sequence[Fit]], lawful: Sequence[int]) -> list[int]:
    """The two that springs tie to each other best, of which not both have a law of their own.

    Beside other things that move, whoever follows them errs more. Springs may leave as much as a
    camera that stands askew, if of each body it is far less than its own laws leave, in the
    geometric mean; beside one that has a law of its own, as much as of a view that is set right.

    Args:
        laws: of each body that is seen in nearly all frames from its first on, before any mending.
        lawful: those that a law of their own moves.
    """
    tied: list[tuple[float, list[int]]] = []
    for pair in map(list, combinations(laws, 2)):
        if set(pair) <= set(lawful):
            continue
        fits = [laws[body] for body in pair]
        both = coupled(_clips(motion, pair), fits, camera=True)
        if not both:
            continue
        best = both[0]
        own = [min(fit.left for fit in each) for each in fits]
        share = float(np.sqrt(np.prod(np.divide(best.left_each, own))))
        askew = STRAIGHTENED if set(pair) & set(lawful) else ASKEW
        most = (askew if share < MUCH_LESS else GOOD) * best.spread
        if best.left < most:
            tied.append((best.left / best.spread, pair))
    return min(tied, default=(0.0, []))[1]


def _lawful(clips: Sequence[Frames], fits: Sequence[Fit]) -> bool:
    """Whether a law moves a body in a picture, also where the camera sees it slightly askew."""
    if any(fit.holds and fit.left < JUMPY * fit.spread for fit in fits if not fit.settles):
        return True
    askew = [pictured(clips, fit) for fit in _nearly(fits)]
    return any(fit.left < STRAIGHTENED * fit.spread for fit in askew)


def _nearly(fits: Sequence[Fit]) -> list[Fit]:
    """Laws that leave little of a motion, which may be a camera's that stands askew."""
    return [fit for fit in fits if not fit.settles and fit.left < ASKEW * fit.spread]
