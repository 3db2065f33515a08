"""Ways to what may be a body beside blobs: its colour, its corners, and what was lost in parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from binders.blobs import Blobs
from binders.carried import carried_bodies, drawn_along
from binders.coloured import coloured_blobs
from binders.exchanged import continued, crossed, told_apart
from binders.follow import Candidate, likely, ranked
from binders.halves import halves
from binders.hypotheses import Hypothesis, hypotheses
from binders.lawful import judge
from binders.reel import Masks
from binders.steadied import Steadied
from binders.wanted import Wanted

# how much less likely a blob is the body alone that may have its shadow, and corners are all of it
DOUBTS = 1.0, 0.75, 0.8, 0.8
CORNERS, COLOURED = 2, 3  # ways to find bodies: by corners, by colour
OF_A_COLOUR = 3  # bodies that may share one
MOSTLY = 0.75  # seen, is what is followed by its colour: it is to show what blobs lose for a while
AS_GOOD = 0.5  # of the score of what is drawn along, that what draws it has
LIKELY = 6  # candidates, of which two may be parts of one


@dataclass(frozen=True)
class Judging:
    """Makes candidates of what was followed, by one measure.

    Args:
        clip: in which it was.
        wanted: what is known of the bodies.
    """

    clip: Steadied
    wanted: Wanted

    def __call__(
        self, found: list[Hypothesis], kind: int, sure: list[float] | None = None
    ) -> list[Candidate]:
        """Of what was found in one way, each beside the others.

        Args:
            found: what was followed.
            kind: the way.
            sure: how sure each is, at most 1.
        """
        fits = [DOUBTS[kind] * self.wanted.fits(h, self.clip.factor) for h in found]
        if sure is not None:
            fits = [fit * each for fit, each in zip(fits, sure, strict=True)]
        judged = judge(found, self.clip.steps, float(min(self.clip.still.shape[1:3])), fits)
        return [Candidate(h, j, kind) for h, j in zip(found, judged, strict=True)]


def by_colour(
    judging: Judging,
    blobs: Sequence[Sequence[Blobs]],
    changed: Masks,
    inside: np.ndarray | None,
    thin: int,
) -> list[Candidate]:
    """Bodies that are seen by their colour nearly always, also before what else moves."""
    clip, likeliest = judging.clip, list[Candidate]()
    for each in coloured_blobs(clip.still, clip.sample, blobs, changed, inside, thin):
        pieces = hypotheses(each, clip.steps)
        judged = judging(pieces + halves(pieces), COLOURED)
        often = [c for c in judged if c.judged.seen > MOSTLY]
        likeliest += sorted(often, key=lambda c: -c.judged.score)[:OF_A_COLOUR]
    return likeliest


def by_corners(
    judging: Judging, background: np.ndarray, changed: Masks, inside: np.ndarray | None
) -> list[Candidate]:
    """Bodies that are known by their corners."""
    clip = judging.clip
    found = carried_bodies(clip.still, clip.sample, background, changed, clip.steps, inside)
    return judging([body for body, _ in found], CORNERS, [sure for _, sure in found])


def in_parts(judging: Judging, found: list[Candidate]) -> list[Candidate]:
    """What was followed in parts, of the likeliest bodies."""
    joined = []
    for kind in {each.kind for each in found}:
        bodies = [each.body for each in found[:LIKELY] if each.kind == kind]
        wholes = crossed(bodies) + continued(bodies, judging.clip.steps)
        joined += judging(bodies + wholes, kind)[len(bodies) :]
    return joined


def untangled(judging: Judging, judged: list[Candidate]) -> list[Candidate]:
    """The same candidates, of which the likeliest are no longer taken for one another.

    What was followed as one of them may hide a better one, that is followed otherwise.
    """
    chosen = likely(ranked(judged))
    told = told_apart(chosen)
    mixed = {id(old): new for old, new in zip(chosen, told, strict=True) if old is not new}
    kept = [each for each in judged if id(each.body) not in mixed]
    for each in judged:
        if id(each.body) in mixed:
            alike = [other.body for other in kept if other.kind == each.kind]
            kept += judging([*alike, mixed[id(each.body)]], each.kind)[-1:]
    return kept


def alone(found: list[Candidate], others: list[Candidate]) -> list[Candidate]:
    """What is found, without what others draw along or is a part of them."""

    def better(than: Candidate) -> list[Hypothesis]:
        least = AS_GOOD * than.judged.score
        return [each.body for each in found + others if each.judged.score > least]

    return [each for each in found if not drawn_along(each.body, better(each))]
