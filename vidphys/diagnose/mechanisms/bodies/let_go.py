"""Bodies that a hand lets go, and that a law moves from then on."""

from __future__ import annotations

from itertools import islice

import numpy as np

from vidphys.diagnose.mechanisms.bodies.extents import (
    LITTLE,
    RELEASED,
    RESTS,
    SELDOM,
    extent,
    not_at_rest,
    rests,
    shown_enough,
    spread,
    stays_on,
)
from vidphys.diagnose.mechanisms.choose import roughly
from vidphys.diagnose.mechanisms.fitted import GOOD, Fit
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.mechanism import lawful_from, thinned
from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

MOST_TRIED = 3  # bodies of a clip, of which it is asked whether a law moves them; of all, if none
BADLY = 0.5  # of the spread: what a law leaves at most of a body that is followed badly


def released(motion: Motion, lawful: list[int]) -> list[int]:
    """Bodies that stay once they are there, and that a law moves once what held them has let go.

    A hand that lets go comes and goes, and for so short a time any law fits it. Or it rests; so one
    that rests at the end is asked last, and only where a law moves no other. Or it stays in view:
    where the likeliest flies, only what flies was let go. What hardly moves is a spot of noise;
    what goes far less than another is the hand, if it comes to rest, or if the other is likelier
    and bounces too often for one law to have all of its way.

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
    staying = [b for b in asked if shown_enough(motion, b) and stays_on(motion, b)]
    resting = [body for body in staying if rests(motion, body)]
    staying = [body for body in staying if body not in resting]
    staying += [] if lawful else resting
    far = not_at_rest(motion, staying, LITTLE)
    staying = [body for body in staying if body in far or body not in resting]
    laws = {body: _laws_once_free(motion, body) for body in staying}
    found = [body for body in staying if laws[body]]
    flying = [b for b in found if any(x.model.law.restoring == "uniform" for x in laws[b])]
    found = flying if flying[:1] == found[:1] else found
    if found and not set(found) & set(far):
        found = _first_lawful_later(motion, [x for x in far if x < found[0]]) or found
    if found or any(stays_on(motion, x) and not rests(motion, x) for x in lawful):
        return found
    return _first_lawful_later(motion, not_at_rest(motion, staying))


def _first_lawful_later(motion: Motion, bodies: list[int]) -> list[int]:
    return list(islice((body for body in bodies if lawful_later(motion, body)), 1))


def _laws_once_free(motion: Motion, body: int) -> list[Fit]:
    """Those that leave little of its way after a hand has let go; none where too little is seen."""
    seen = np.flatnonzero(motion.seen[0, :, body])
    seen = seen[seen >= int(RELEASED * motion.positions.shape[1])]
    if len(seen) < LEAST_FRAMES + 2:
        return []
    clips = frames_of(thinned(motion.of([body]).cut(seen[0], seen[-1] + 1)))
    return [x for x in roughly(clips, angles=False) if x.left < GOOD * x.spread]


def lawful_later(motion: Motion, body: int) -> bool:
    """Whether a law moves it from a later frame on, and it neither rests then nor jumps about."""
    alone = motion.of([body])
    alone = alone.cut(*alone.shown())
    path = alone.positions[0, :, 0]
    least = RESTS * extent(path)
    return any(
        extent(path[first:]) > least and left < BADLY * spread(path[first:])
        for first, left in lawful_from(alone, angles=False)
    )
