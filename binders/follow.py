"""The bodies of a clip: of all that can be followed, what moves most lawfully."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from binders.blobs import Blobs
from binders.hypotheses import Hypothesis
from binders.lawful import Judged
from binders.struck import strike

STRONG = 0.5  # of the usual energy of what is followed: as strong is no shadow of it
SAME = 0.5  # share of its frames, in which a hypothesis is where a better one is
HELD = 0.8  # share of its frames, in which what goes on where it was lost is where it is
LONGER, GOES_ON = 1.3, 0.8  # times the frames, and of the score, of what does so
NEARLY = 0.45  # of the score of the likeliest, from which another is a body too
HALF_AS = 0.25  # and if it is as large and surely one thing
AS_LARGE = 1.25, 1.5  # times the size; and where both were found in the same way
ALWAYS, STEADY = 0.95, 0.9  # seen, and steady in looks, is what is surely one thing
FIFTH_AS = 0.2  # and if that one thing goes as bodies do
THIRD_AS = 0.3  # and if it goes as bodies do and is no shadow: as :class:`Judged` counts it,
OFTEN, FORETOLD, UNLIT = 0.85, 1.0, 0.1  # seen and foretold by more than that, and lit by less;
WHOLLY, ROUGHLY, ALIKE = 0.98, 0.75, 0.6  # or seen so, foretold so, and as steady in looks;
SURELY, HALF_LIT = 1.5, 0.5  # or as often, surely foretold and steady, and half of it unlit
ON_A_ROD = 0.25  # and if it keeps at one distance from the likeliest, as the end of a rod does
EVENLY = 0.04  # of the distance, by which most of the distances may differ
STRUCK = 0.15  # and if both strike each other: what is slow is foretold less well
LITTLE, TOUCHES, ALONG = 0.4, 1.5, 0.6  # times the size of a body that goes as bodies do, of a
# piece of what that hangs by; as near as that to it; and what its way leaves of the piece's
SWAYS = 0.5  # radians, by which the rod between them turns at least
MOST = 8  # bodies, where nobody says how many
MOSTLY = 0.8  # of the frames, in which both ends of a rod are seen
HARDLY = 0.02  # how likely what turns in its place, or is but a shadow, is a body


@dataclass(frozen=True)
class Path:
    """Bodies followed through the clip.

    Args:
        positions: ``(t, n, 2)`` pixels; interpolated in time where a body was not seen.
        confidence: ``(t, n)``: energy of the blob relative to the body's median, at most 1; 0
            where it was not seen.
        radius: ``(t, n)``, half the narrower width of a body, pixels; NaN where no blob shows it.
        others: share of the frames in which a blob that is as strong is not followed.
    """

    positions: Float[np.ndarray, "t n 2"]
    confidence: Float[np.ndarray, "t n"]
    radius: Float[np.ndarray, "t n"]
    others: float


@dataclass(frozen=True)
class Candidate:
    """Something that may be a body.

    Args:
        body: where it was seen, in pixels of the working image.
        judged: what speaks for it.
        kind: which of the ways to find blobs shows it.
    """

    body: Hypothesis
    judged: Judged
    kind: int


def ranked(candidates: list[Candidate]) -> list[Candidate]:
    """The likeliest first, each body once, as long as it is seen."""
    kept: list[Candidate] = []
    for each in sorted(candidates, key=lambda c: -c.judged.score):
        if each.judged.score <= 0:
            break
        known = [
            n
            for n, k in enumerate(kept)
            if _same(each.body, k.body) > SAME or _same(k.body, each.body) > HELD
        ]
        if not known:
            kept.append(each)
        elif all(_goes_on(each, kept[n], kept[:n]) for n in known):
            kept[known[0]] = each
            kept = [k for n, k in enumerate(kept) if n not in known[1:]]
    return kept


def _goes_on(longer: Candidate, shorter: Candidate, likelier: list[Candidate]) -> bool:
    """Whether one is nearly as likely, and follows the other to where that one was lost.

    One is lost, too, where it is followed on as a likelier body, as that which struck it.
    """
    alone = shorter.body
    for each in likelier:
        alone = replace(
            alone, positions=np.where(_at_one_place(alone, each.body), np.nan, alone.positions)
        )
    exchanged = bool(alone.seen.sum() < HELD * shorter.body.seen.sum())
    larger = AS_LARGE[exchanged or longer.kind != shorter.kind]
    return bool(
        longer.judged.seen > LONGER * alone.seen.mean()
        and abs(np.log(_size(longer) / _size(shorter))) < np.log(larger)
        and longer.judged.score > GOES_ON * shorter.judged.score
        and _same(alone, longer.body) > HELD
    )


def _at_one_place(one: Hypothesis, other: Hypothesis) -> np.ndarray:
    """Frames in which both are seen nearer to each other than the larger one's size, ``(t, 1)``."""
    apart = np.linalg.norm(one.positions - other.positions, axis=-1)
    near = apart < max(one.usual_size, other.usual_size)  # false where one is not seen
    return np.asarray(near)[:, None]


def _same(one: Hypothesis, other: Hypothesis) -> float:
    """Share of the frames that show one, in which it is where the other is."""
    return float(_at_one_place(one, other).sum() / max(one.seen.sum(), 1))


def likely(candidates: list[Candidate]) -> list[Hypothesis]:
    """The bodies, of those ranked: the first, and what is nearly as likely.

    What is as large as the first and is steady in all frames need be less likely: a body that
    moves little is foretold less well. So need what no shadow explains and goes as bodies do: one
    that has the colour of what is behind it is told by its brightness alone. A piece of the string
    or spring by which a body hangs is none.
    """
    first = candidates[:1]
    bodies = []
    for number, each in enumerate(candidates[:MOST]):
        if any(_hangs_at(each, other) for other in candidates[:number]):
            continue
        largest = AS_LARGE[each.kind == first[0].kind]
        alike = abs(np.log(_size(each) / _size(first[0]))) < np.log(largest)
        certain = alike and each.judged.seen > ALWAYS and each.judged.steady > STEADY
        judged = replace(each.judged, lit=0.0) if certain else each.judged
        if _goes_as_bodies_do(judged):
            least = FIFTH_AS if certain else THIRD_AS
        else:
            least = HALF_AS if certain else NEARLY
        score = judged.score / first[0].judged.score
        if score >= least:
            bodies.append(each.body)
        elif score >= ON_A_ROD and _on_a_rod(each, first[0]):
            bodies.insert(1, each.body)
        elif score >= STRUCK and strike(each.body, first[0].body):
            bodies.append(each.body)
    return bodies


def _goes_as_bodies_do(judged: Judged) -> bool:
    foretold = judged.seen > OFTEN and judged.foretold > FORETOLD
    whole = judged.seen > WHOLLY
    always = whole and judged.foretold > ROUGHLY and judged.steady > ALIKE
    surely = whole and judged.foretold > SURELY and judged.steady > STEADY
    return ((foretold or always) and judged.lit < UNLIT) or (surely and judged.lit < HALF_LIT)


def _hangs_at(piece: Candidate, body: Candidate) -> bool:
    """Whether something small keeps to a body that goes as bodies do, and mostly goes with it."""
    one, other = piece.body, body.body
    if _size(piece) > LITTLE * _size(body) or not _goes_as_bodies_do(body.judged):
        return False
    apart = np.linalg.norm(one.positions - other.positions, axis=-1)
    if (apart < TOUCHES * _size(body)).sum() < HELD * one.seen.sum():
        return False
    way, own = (x.positions[one.seen & other.seen] for x in (other, one))
    way, own = way - way.mean(0), own - own.mean(0)
    share = (way * own).sum() / max((way**2).sum(), np.finfo(float).tiny)
    return bool(((own - share * way) ** 2).sum() < ALONG * (own**2).sum())


def _on_a_rod(one: Candidate, other: Candidate) -> bool:
    """Whether both are the ends of a rod that turns: they stay apart, whichever way they go."""
    seen = one.body.seen & other.body.seen
    if seen.mean() < MOSTLY:
        return False
    between = one.body.positions[seen] - other.body.positions[seen]
    apart = np.linalg.norm(between, axis=-1)
    usual = np.median(apart)
    turned = np.unwrap(np.arctan2(between[:, 1], between[:, 0]))
    return bool(
        usual > _size(one) + _size(other)  # nearer, it is a part of it
        and np.percentile(np.abs(apart / usual - 1), 90) < EVENLY
        and np.ptp(turned) > SWAYS
    )


def _size(candidate: Candidate) -> float:
    return candidate.body.usual_size


def put_last(candidates: list[Candidate], which: set[int]) -> list[Candidate]:
    """The same candidates, of which some are hardly bodies."""
    weighed = [
        replace(c, judged=replace(c.judged, fits=HARDLY * c.judged.fits)) if k in which else c
        for k, c in enumerate(candidates)
    ]
    return sorted(weighed, key=lambda c: -c.judged.score)


def path_of(blobs: list[Blobs], bodies: list[Hypothesis]) -> Path:
    """The bodies side by side, with what was seen beside them."""
    frames = len(blobs)
    positions = np.zeros((frames, len(bodies), 2))
    confidence = np.zeros((frames, len(bodies)))
    for n, body in enumerate(bodies):
        seen = np.nonzero(body.seen)[0]
        for axis in (0, 1):
            positions[:, n, axis] = np.interp(np.arange(frames), seen, body.positions[seen, axis])
        confidence[seen, n] = np.minimum(1.0, body.energy[seen] / np.nanmedian(body.energy))
    strong = STRONG * min(float(np.nanmedian(body.energy)) for body in bodies)
    sizes = np.array([body.usual_size for body in bodies])
    others = [
        bool((_far(b, places, sizes) & (b.energy > strong)).any())
        for b, places in zip(blobs, positions, strict=True)
    ]
    radius = np.stack([body.radius for body in bodies], 1)
    return Path(positions, confidence, radius, float(np.mean(others)))


def _far(blobs: Blobs, places: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    away = np.linalg.norm(blobs.centre[:, None] - places, axis=-1)
    return (away > np.maximum(sizes, blobs.size[:, None])).all(1)
