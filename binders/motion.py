"""A hand-made binder for real clips: what moves before a background, and as bodies do, is a body.

The camera's drift is undone and the background subtracted. Lumps of change that have no thin parts
(a string is thin) are followed by the least acceleration and by their looks, several at once; those
whose motion is the most lawful are the bodies. Nothing is learned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float

from binders.base import BINDERS, MotionTracks, Pictures
from binders.blobs import Blobs
from binders.camera import background_of
from binders.candidates import Judging, alone, by_colour, by_corners, in_parts, untangled
from binders.exchanged import apart, told_apart
from binders.follow import MOST, Candidate, likely, path_of, put_last, ranked
from binders.hypotheses import Hypothesis, hypotheses
from binders.lookalike import seen_again
from binders.placed import placed
from binders.reel import Masks
from binders.scenery import Scenery, lumps, threshold_of
from binders.shade import shadows
from binders.steadied import Steadied
from binders.tracks import Tracks
from binders.wanted import Wanted, in_working_pixels
from binders.wheels import wheels

HIDING = 1.5, 4.0  # radii, and pixels
LARGE = 0.2  # of the picture's shorter side, a radius beyond which the background is not cleaned
PASSES = 3  # the last one only where ghosts are left
SHADOW = 0.6
LIKE_IT = 10.0  # of :meth:`Wanted.likeness`, from which a pixel has the colour
UNSAID = 0.02  # of the picture's shorter side: radius of a body of which only a place is said
HAUNTED = 3  # sampled frames with a ghost, that show what is behind it
RIM = 3  # pixels around a ghost, that are its soft edge
HIDDEN = 0.5  # of the best score, from which the background is cleaned of a hypothesis


@BINDERS.register("motion")
@dataclass(frozen=True)
class MotionBinder:
    """Follows the moving bodies of a clip before a background that stands (nearly) still.

    Args:
        bodies: how many bodies to follow; unless given, as many as move nearly as lawfully.
        shadow: a pixel whose colour is the background's times a factor between this and its
            inverse counts as lit differently, not as a body; 1 keeps every change. Unless given,
            it is 0.6 where anything moves that differs in more than brightness. A deeper shadow
            is told by what is seen through it.
        thin: structures thinner than this many pixels (of the working image, at most 480 on its
            longer side) belong to no body: strings, rods, edges.
        wanted: what is known of the bodies.

    Raises:
        ValueError: numbers outside these ranges.

    Example:
        >>> frames = np.zeros((12, 48, 64, 3), np.uint8)
        >>> for t in range(12):
        ...     frames[t, 20:28, 4 + 4 * t : 12 + 4 * t] = 255
        ...
        >>> found = MotionBinder(bodies=1, shadow=1.0)(frames, np.arange(12) / 30)
        >>> [round(x, 2) for x in found.tracks.positions[0, [0, 11], 0, 0].tolist()]  # half sides
        [-0.75, 0.62]
    """

    streams: ClassVar[bool] = True

    bodies: int | None = 1
    shadow: float | None = None
    thin: int = 3
    wanted: Wanted = Wanted()

    def __post_init__(self) -> None:
        if self.bodies is not None and self.bodies < 1:
            raise ValueError(f"bodies {self.bodies}: follow at least 1")
        if self.shadow is not None and not 0 < self.shadow <= 1:
            raise ValueError(f"shadow {self.shadow}: must be above 0 and at most 1")

    def __call__(self, frames: Pictures, times: Float[np.ndarray, " t"]) -> MotionTracks:
        """See :class:`binders.base.Binder`.

        Raises:
            ValueError: fewer than three frames, no frame in which all bodies are seen, or what is
                said of them fits nothing that moves.
        """
        self.wanted.require(len(frames), *frames.shape[1:3])
        clip = Steadied(frames, times)
        view = _view(clip, self)
        bodies = [
            seen_again(placed(body, clip.still, view.changed, clip.steps), clip.still, view.changed)
            for body in told_apart(apart(_chosen(clip, view, self)))
        ]
        path = path_of(view.blobs[0], bodies)
        tracks = Tracks(
            torch.from_numpy(clip.normalised(clip.seen(path.positions)))[None].float(),
            torch.from_numpy(path.confidence)[None].float(),
            torch.from_numpy(times),
        )
        radius = torch.from_numpy(path.radius / clip.half).float()
        return MotionTracks(tracks, clip.camera, path.others, radius)

    def candidates(
        self, frames: Pictures, times: Float[np.ndarray, " t"]
    ) -> tuple[Float[np.ndarray, "t k 2"], Float[np.ndarray, " k"]]:
        """What may be a body, the likeliest first, in the order that `Wanted.choose` counts.

        Returns:
            Places in pixels of the clip, NaN where one is not seen, and the usual radius of each.

        Raises:
            ValueError: fewer than three frames.
        """
        clip = Steadied(frames, times)
        found = [each.body for each in _view(clip, self).candidates]
        places = clip.seen(np.stack([b.positions for b in found], 1))
        sizes = np.array([b.usual_size for b in found])
        return clip.factor * (places + 0.5) - 0.5, clip.factor * sizes


@dataclass(frozen=True)
class _View:
    """What is seen before the background.

    Args:
        blobs: of each frame, in each of the ways to find them.
        changed: pixels that differ from the background in more than brightness, of each frame.
        candidates: the likeliest body first.
    """

    blobs: list[list[Blobs]]
    changed: Masks
    candidates: list[Candidate]


def _view(clip: Steadied, settings: MotionBinder) -> _View:
    """What may be bodies before a background that is cleaned of those that are known."""
    judging, sampled = Judging(clip, settings.wanted), clip.still[clip.sample].astype(np.float32)
    hidden, clear = None, np.zeros(sampled.shape[:3], bool)
    followed: dict[int, list[Hypothesis]] = {}  # before each background: the last need not be best
    for number in range(PASSES):
        background = background_of(sampled, hidden)
        blobs, changed, ghosts = _blobs(clip, background, sampled, settings)
        for kind, b in enumerate(blobs):
            followed[kind] = followed.get(kind, []) + hypotheses(b, clip.steps)
        judged = [each for kind, some in followed.items() for each in judging(some, kind)]
        candidates = ranked(judged)
        if number > 0 and (ghosts.sum(0) >= HAUNTED).sum() < _area(candidates):
            break
        clear |= ghosts
        often = clear.sum(0) >= HAUNTED
        hidden = _discs(candidates, clip) | (often & ~clear)
    judged += in_parts(judging, candidates)
    if settings.wanted.colour is None:
        inside = settings.wanted.where(background.shape[0], background.shape[1], clip.factor)
        coloured = by_colour(judging, blobs, changed, inside, settings.thin)
        judged += alone(coloured + by_corners(judging, background, changed, inside), judged)
    found = ranked(untangled(judging, judged))
    found = put_last(found, wheels([each.body for each in found[:MOST]]))
    if settings.shadow != 1:
        found = put_last(found, shadows(found, clip.still, background))
    return _View(blobs, changed, found)


def _blobs(
    clip: Steadied, background: np.ndarray, sampled: np.ndarray, settings: MotionBinder
) -> tuple[list[list[Blobs]], Masks, np.ndarray]:
    """The blobs of each frame, which pixels changed, and where ghosts are in those of the sample.

    Where no shadow is named, once as they are without what a shadow explains, and once with it.
    Where a colour is, they are what has it.
    """
    import cv2

    said, wanted = settings.shadow, settings.wanted
    scenes = [Scenery(background, shadow) for shadow in ([said] if said else [SHADOW, 1.0])]
    limits = [threshold_of(np.stack([s.change(image) for image in sampled[::4]])) for s in scenes]
    blobs: list[list[Blobs]] = [[] for _ in (scenes if wanted.colour is None else [0])]
    height, width = clip.still.shape[1:3]
    changed, rows = Masks((height, width)), {frame: k for k, frame in enumerate(clip.sample)}
    ghosts = np.zeros((len(clip.sample), height, width), bool)
    inside = wanted.where(height, width, clip.factor)
    behind = background if wanted.colour is None else None
    for frame, image in enumerate(clip.still):
        changes = [scene.change(image) for scene in scenes]
        mask = changes[0] > limits[0]
        changed.append(mask)
        if wanted.colour is None:
            pairs = [(c, limit, mask) for c, limit in zip(changes, limits, strict=True)]
        else:
            pairs = [(wanted.likeness(image), LIKE_IT, np.ones_like(mask))]
        for kind, (change, limit, coloured) in zip(blobs, pairs, strict=True):
            found, haunted = lumps(image, change, limit, settings.thin, coloured, behind)
            if frame in rows:
                ghosts[rows[frame]] |= haunted
            if inside is not None:
                x, y = np.rint(found.centre).astype(int).T
                found = found.only(inside[y, x])
            kind.append(found)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    rims = [cv2.dilate(each.view(np.uint8), cross, iterations=RIM) for each in ghosts]
    return blobs, changed, np.stack(rims).view(bool)


def _area(candidates: list[Candidate]) -> float:
    """Of the likeliest body, pixels; 0 where there is none."""
    return float(np.pi * candidates[0].body.usual_size ** 2) if candidates else 0.0


def _discs(candidates: list[Candidate], clip: Steadied) -> np.ndarray:
    """Where likely bodies are in the sampled frames, with what is next to them, ``(t, h, w)``."""
    size = clip.still.shape[1:3]
    y, x = np.ogrid[: size[0], : size[1]]
    hidden = np.zeros((len(clip.sample), *size), bool)
    for each in candidates:
        radius = HIDING[0] * each.body.usual_size + HIDING[1]
        if each.judged.score < HIDDEN * candidates[0].judged.score or radius > LARGE * min(size):
            continue
        seen = np.nonzero(each.body.seen)[0]
        places = each.body.positions[seen]
        px, py = (np.interp(clip.sample, seen, places[:, axis]) for axis in (0, 1))
        for frame, cx, cy in zip(hidden, px, py, strict=True):
            frame |= (x - cx) ** 2 + (y - cy) ** 2 <= radius**2
    return hidden


def _chosen(clip: Steadied, view: _View, settings: MotionBinder) -> list[Hypothesis]:
    """The bodies that are followed.

    Raises:
        ValueError: there are not so many.
    """
    found, wanted = view.candidates, settings.wanted
    if wanted.choose:
        if max(wanted.choose) > len(found) or min(wanted.choose) < 1:
            raise ValueError(f"choose {max(wanted.choose)}: there are candidates 1 to {len(found)}")
        return [found[number - 1].body for number in wanted.choose]
    bodies = [each.body for each in found]
    if wanted.at:
        bodies = _at(clip, bodies, wanted)
    elif settings.bodies is None:
        bodies = likely(found)
    count = settings.bodies or len(bodies)
    if not bodies or len(bodies) < count:
        raise ValueError(
            f"MotionBinder: no frame shows {count or 1} moving bodies that its edge does not cut; "
            "check the number of bodies, or keep changes of brightness (shadow 1)"
        )
    return bodies[:count]


def _at(clip: Steadied, bodies: list[Hypothesis], wanted: Wanted) -> list[Hypothesis]:
    """The bodies that are where it was said, or else what looks like what is there."""
    met = [(set(wanted.meets(body, clip.factor)), body) for body in bodies]
    left, chosen = set(range(len(wanted.at))), []
    for places, body in met:
        if places & left:
            chosen.append(body)
            left -= places
    return chosen + ([_told(clip, wanted, sorted(left))] if left else [])


def _told(clip: Steadied, wanted: Wanted, places: list[int]) -> Hypothesis:
    """A body of which only places are known."""
    frames = len(clip.still)
    positions, values = np.full((frames, 2), np.nan), np.full((5, frames), np.nan)
    size = UNSAID * min(clip.still.shape[1:3])
    if wanted.size is not None:
        size = wanted.size / 2 / clip.factor
    for x, y, frame in (wanted.at[place] for place in places):
        positions[frame] = in_working_pixels(x, y, clip.factor)
        values[:, frame] = 1.0, size, size, 1.0, 0.0
    energy, sizes, radius, compact, lit = values
    return Hypothesis(positions, energy, sizes, radius, np.zeros((frames, 3)), compact, lit)
