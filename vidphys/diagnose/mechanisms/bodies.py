"""Which of the things that were followed in a clip are bodies that a law moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice

import numpy as np

from vidphys.diagnose.mechanisms.chain import linked
from vidphys.diagnose.mechanisms.choose import pictured, roughly
from vidphys.diagnose.mechanisms.coupled import coupled
from vidphys.diagnose.mechanisms.fitted import GOOD, Fit
from vidphys.diagnose.mechanisms.frames import Frames, frames_of
from vidphys.diagnose.mechanisms.mechanism import lawful_from, meeting, thinned
from vidphys.diagnose.mechanisms.passers import passes_by, turns_back
from vidphys.diagnose.mechanisms.rods import at_one_distance, rods_in_picture
from vidphys.diagnose.mechanisms.shadows import goes_with, without_shadows
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion
from vidphys.diagnose.recordings.parted import parted

MOST_TRIED = 3  # bodies of a clip, of which it is asked whether a law moves them; of all, if none
ASKEW = 0.15  # of the spread: the same before the camera's view is set right
STRAIGHTENED = 0.05  # of the spread: the same after it, of a body whose ends are often cut
JUMPY = 0.2  # of the spread: noise, beyond which no law is seen to move a body
BADLY = 0.5  # the same, of what is followed badly but by a law
SELDOM = 0.6  # of another body's frames
MUCH_LESS = 0.5  # of what two bodies' own laws leave, that springs between them leave
FAR_LESS = 0.3  # of what two rods leave, that a law of one weight by itself leaves
ALWAYS = 0.9  # of the frames, in which one is seen that does not come and go
MOSTLY = 0.85  # of the frames from its first on, in which one is seen that a hand let go
SETTLED = 0.3  # of the frames that show it, from which something stays that settles early
RELEASED = 0.6  # of the frames, after which a hand has let go
LITTLE = 0.3  # of another's extent: what goes less and comes to rest was not let go
RESTS = 0.1  # of the extent of all of its motion, that it has at most from then on if it rests


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
        return _of(motion, chain), _said(motion.bodies, len(chain))
    if len(alone) == 1:
        return _of(motion, alone), shadows
    motion = _of(motion, alone)
    going = _without_passers(motion)
    if len(going) < motion.bodies:
        kept, found, _ = _lawful_of(_of(motion, going))
        if found:
            return _of(kept, found), (*shadows, *_said(motion.bodies, len(found)))
    kept, found, nearly = _lawful_of(motion)
    both = motion.bodies == 2 and len(_seen_enough(motion, _not_at_rest(motion, [0, 1]))) == 2
    if both and not found:
        return kept, shadows  # of two that no law moves alone, each may move the other
    found, nearly = (
        [body for body in some if body in going or not turns_back(motion, body)]
        for some in (found, nearly)
    )
    found = found or nearly or _not_at_rest(motion, going)[:1]  # the binder's likeliest
    return _of(kept, found), (*shadows, *_said(motion.bodies, len(found)))


def _pairs(motion: Motion) -> list[list[int]]:
    """Of the likeliest bodies, and what goes as if a rod were between them."""
    return [
        list(pair)
        for pair in combinations(range(motion.bodies), 2)
        if max(pair) < MOST_TRIED or at_one_distance(_of(motion, pair))
    ]


def _chain(motion: Motion) -> list[int]:
    """The ends of two rods, from the pivot on, if there are such.

    In its slow swing one weight of a double pendulum moves in proportion to the other, as a shadow
    does, but a shadow pulls at nothing. No weight swings far better by itself than on two rods, and
    none that moves so swings better at all.
    """
    for pair in _pairs(motion):
        rods = rods_in_picture(_of(motion, pair))
        if rods is not None and linked(rods, angles=False):
            share = 1.0 if goes_with(motion, *pair) else FAR_LESS
            most = share * rods.left / rods.spread
            if all(_least_left(motion, body) > most for body in pair):
                return [pair[end] for end in rods.rods.order]
    return []


def _least_left(motion: Motion, body: int) -> float:
    """What the best law of a body by itself leaves, as a share of its spread."""
    laws = roughly(_clips(motion, [body]), angles=False) if _shown_enough(motion, body) else []
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
    staying = {body: laws[body] for body in _stay(followed, list(laws)[:MOST_TRIED])}
    lawful = _or_likelier(motion, sorted({*lawful, *_tied(motion, staying, lawful)}), laws)
    if not met and not _stay(motion, lawful):
        let_go = _or_likelier(followed, _released(followed, lawful), laws)
        if let_go:
            return followed, let_go, []
    found = met + _seen_enough(motion, lawful)
    for pair in _pairs(motion):
        if set(pair) & set(found) and at_one_distance(_of(motion, pair)):
            found = [*found, *(set(pair) - set(found))]  # a rod may join them
    found = sorted(found)
    nearly = [body for body in laws if _nearly(laws[body])]
    nearly = _not_at_rest(motion, _seen_enough(motion, nearly))
    if _needs_no_mending(followed, motion, found):
        motion = followed
    return motion, found, nearly


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
        if _shown_enough(motion, body):
            clips = _clips(motion, [body])
            laws[body] = roughly(clips, angles=False)
            lawful += [body] if _lawful(clips, laws[body]) else []
    moving = [body for body in lawful if not _settled(motion, body)]
    return laws, _not_at_rest(motion, moving or lawful)


def _or_likelier(motion: Motion, found: list[int], laws: Mapping[int, Sequence[Fit]]) -> list[int]:
    """Bodies, or a likelier one that a law nearly moves and that goes far farther than they do.

    Some law fits whatever only drifts.
    """
    for body in (body for body in laws if body < min(found, default=0) and _nearly(laws[body])):
        if _not_at_rest(motion, [body, *found], LITTLE) == [body]:
            return [body]
    return found


def _needs_no_mending(followed: Motion, motion: Motion, found: list[int]) -> bool:
    """Whether a law moves the one body, if only later, with the frames that mending took from it.

    What it touches in these may be a hand that lets go of it.
    """
    if len(found) != 1 or _of(followed, found).seen.sum() <= _of(motion, found).seen.sum():
        return False
    clips = _clips(followed, found)
    return _lawful(clips, roughly(clips, angles=False)) or _lawful_later(followed, found[0])


def _said(all_: int, looked_at: int) -> tuple[str, ...]:
    """What a person should know, if anything."""
    if looked_at == all_:
        return ()
    return (f"{all_} things move; {looked_at} of them are looked at, as bodies of the scene",)


def _stay(motion: Motion, bodies: list[int]) -> list[int]:
    """Those that are seen in nearly all frames."""
    return [body for body in bodies if motion.seen[..., body].mean() > ALWAYS]


def _released(motion: Motion, lawful: list[int]) -> list[int]:
    """Bodies that stay once they are there, and that a law moves once what held them has let go.

    A hand that lets go comes and goes, and for so short a time any law fits it. Or it rests; so one
    that rests at the end is asked last, and only where a law moves no other. Or it stays in view:
    where the likeliest flies, only what flies was let go. What hardly moves is a spot of noise,
    and what comes to rest and goes far less than another is the hand.

    Args:
        lawful: what a law moves already: asked are bodies that are likelier than these, or of the
            likeliest those that are seen in far more frames; all, where there is none.
    """
    seen = motion.seen[0].mean(0)
    most = max(seen[lawful], default=0.0)
    asked = [
        body
        for body in range(motion.bodies)
        if body < min(lawful, default=motion.bodies)
        or (body < MOST_TRIED and most < SELDOM * seen[body])
    ]
    staying = [b for b in asked if _shown_enough(motion, b) and _stays_on(motion, b)]
    resting = [body for body in staying if _rests(motion, body)]
    staying = [body for body in staying if body not in resting]
    staying += [] if lawful else resting
    far = _not_at_rest(motion, staying, LITTLE)
    staying = [body for body in staying if body in far or body not in resting]
    laws = {body: _laws_once_free(motion, body) for body in staying}
    found = [body for body in staying if laws[body]]
    flying = [b for b in found if any(x.model.law.restoring == "uniform" for x in laws[b])]
    found = flying if flying[:1] == found[:1] else found
    if found or any(_stays_on(motion, x) and not _rests(motion, x) for x in lawful):
        return found
    moving = _not_at_rest(motion, staying)
    return list(islice((x for x in moving if _lawful_later(motion, x)), 1))


def _laws_once_free(motion: Motion, body: int) -> list[Fit]:
    """Those that leave little of its way after a hand has let go; none where too little is seen."""
    seen = np.flatnonzero(motion.seen[0, :, body])
    seen = seen[seen >= int(RELEASED * motion.positions.shape[1])]
    if len(seen) < LEAST_FRAMES + 2:
        return []
    clips = frames_of(thinned(_of(motion, [body]).cut(seen[0], seen[-1] + 1)))
    return [x for x in roughly(clips, angles=False) if x.left < GOOD * x.spread]


def _lawful_later(motion: Motion, body: int) -> bool:
    """Whether a law moves it from a later frame on, and it neither rests then nor jumps about."""
    alone = _of(motion, [body])
    alone = alone.cut(*alone.shown())
    path = alone.positions[0, :, 0]
    least = RESTS * _extent(path)
    return any(
        _extent(path[first:]) > least and left < BADLY * _spread(path[first:])
        for first, left in lawful_from(alone, angles=False)
    )


def _stays_on(motion: Motion, body: int) -> bool:
    """Whether it is seen in nearly all frames from the first that shows it."""
    seen = motion.seen[0, :, body]
    return bool(seen.any() and seen[seen.argmax() :].mean() > MOSTLY)


def _rests(motion: Motion, body: int) -> bool:
    """Whether it hardly moves any more when a hand has let go."""
    path = motion.positions[0, :, body]
    late = path[int(RELEASED * len(path)) :]
    return _extent(late) < RESTS * _extent(path)


def _settled(motion: Motion, body: int) -> bool:
    """Whether it moves in the first few of the frames that show it, and then stays."""
    path = motion.positions[0, motion.seen[0, :, body], body]
    return _extent(path[int(SETTLED * len(path)) :]) < RESTS * float(np.ptp(path, axis=0).max())


def _not_at_rest(motion: Motion, bodies: list[int], share: float = RESTS) -> list[int]:
    """Those that go at least such a share as far as the one that goes farthest."""
    extents = {body: _extent(motion.positions[0, :, body]) for body in bodies}
    most = max(extents.values(), default=0.0)
    return [body for body in bodies if extents[body] >= share * most]


def _extent(path: np.ndarray) -> float:
    """Of places ``(t, d)``, of which some are seen; the farthest few may be errors."""
    low, high = np.nanpercentile(path, [5, 95], axis=0) if np.isfinite(path).any() else (0.0, 0.0)
    return float(np.linalg.norm(np.subtract(high, low)))


def _spread(path: np.ndarray) -> float:
    """Root mean square distance of places ``(t, d)`` from their mean."""
    return float(np.sqrt(np.nanvar(path, axis=0).sum()))


def _of(motion: Motion, bodies: Sequence[int]) -> Motion:
    some = list(bodies)
    return replace(motion, positions=motion.positions[:, :, some], mass=motion.mass[:, some])


def _shown_enough(motion: Motion, body: int) -> bool:
    """Whether as many frames show a body as a force takes to be seen."""
    return int(motion.seen[:, :, body].sum()) >= LEAST_FRAMES


def _clips(motion: Motion, bodies: list[int]) -> list[Frames]:
    """The frames in which these are seen."""
    some = _of(motion, bodies)
    first, last = some.shown()
    return frames_of(thinned(some.cut(first, last)))


def _tied(motion: Motion, laws: Mapping[int, Sequence[Fit]], lawful: Sequence[int]) -> list[int]:
    """The two that springs tie to each other best, of which not both have a law of their own.

    Beside other things that move, whoever follows them errs more. Springs may leave as much as a
    camera that stands askew, if of each body it is far less than its own laws leave, in the
    geometric mean; beside one that has a law of its own, as much as of a view that is set right.

    Args:
        laws: of each body that is seen in nearly all frames, before any mending.
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


def _seen_enough(motion: Motion, bodies: list[int]) -> list[int]:
    """Without those seen in far fewer frames than another: a body's shadow, or a piece of it."""
    seen = motion.seen.mean((0, 1))
    most = max((seen[body] for body in bodies), default=0.0)
    return [body for body in bodies if seen[body] > SELDOM * most]
