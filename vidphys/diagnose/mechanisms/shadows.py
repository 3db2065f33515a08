"""What moves in proportion to a body all the time: its shadow, a reflection, or a piece of it."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from vidphys.diagnose.recordings.motion import LEAST_FRAMES, Motion

# of its way: what two bodies leave of the proportion at least that move by themselves; a lens bends
# that of a shadow by up to 0.031, in clips filmed for development
APART = 0.04
ALIKE = 0.03  # of a body's way, by which one that is made alike and let go alike may differ
SWINGS = 3  # times at least that it passes its middle: what does not come back tells nothing
TOGETHER = 0.9  # of the frames in which the less seen one is seen, so that both are


def without_shadows(motion: Motion) -> tuple[list[int], tuple[str, ...]]:
    """Bodies that are not another's shadow, of several followed things.

    Along the way that it swings most, a shadow is where its body is, times a factor. Two bodies do
    that only if they are let go together and are alike, and then their ways are each other's copy.

    Args:
        motion: of one clip; the likeliest bodies come first.

    Returns:
        The bodies, and what a person should know of those that are none.
    """
    cast: dict[int, int] = {}
    for body, other in combinations(range(motion.bodies), 2):
        if body not in cast and other not in cast and _follows(motion, body, other):
            cast[other] = body
    said = tuple(
        f"thing {other + 1} moves in proportion to thing {body + 1}, as its shadow, reflection or "
        "a piece of it does: it is left out"
        for other, body in cast.items()
    )
    return [body for body in range(motion.bodies) if body not in cast], said


def _follows(motion: Motion, body: int, other: int) -> bool:
    """Whether one moves in proportion to another, and is no copy of it."""
    places = motion.positions[0][:, [body, other]]
    seen = np.isfinite(places).all(-1)
    both = seen.all(-1)
    if both.sum() < max(LEAST_FRAMES, TOGETHER * seen.sum(0).min()):
        return False
    here = places[both] - places[both].mean(0)
    main = [np.linalg.svd(here[:, i], full_matrices=False)[2][0] for i in range(2)]
    one, two = (here[:, i] @ main[i] for i in range(2))
    left = np.linalg.norm(two - one * (one @ two) / (one @ one)) / np.linalg.norm(two)
    copied = np.linalg.norm(here[:, 1] - here[:, 0]) / np.linalg.norm(here[:, 0])
    swings = np.count_nonzero(np.diff(np.sign(one)))
    return bool(left < APART and copied > ALIKE and swings >= SWINGS)
