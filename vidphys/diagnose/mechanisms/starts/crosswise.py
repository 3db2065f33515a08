"""A body that a force pushes across its way, by its speed: a charge in a magnetic field, or what
moves in a frame that turns (Coriolis), as the plane of Foucault's pendulum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.charts import Plane
from vidphys.diagnose.mechanisms.fit import with_friction_or_none
from vidphys.diagnose.mechanisms.fitted import Fit, Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.starts.guesses import Local, halves, joined, seen_in, start_of

SPACES = (2, 3)  # dimensions in which a way can be turned
VAGUE = 0.1  # of the turning: a standard error from which it is not told
LEAST = 0.1  # radians by which a way is turned in all


def crosswise(clips: Sequence[Frames]) -> list[Fit]:
    """Laws of a body that is turned, and that nothing else, a steady force or a spring acts on.

    Args:
        clips: of the body.
    """
    places = [clip.stretches[0].places for clip in clips]
    size = places[0].shape[1]
    if size not in SPACES or clips[0].inputs is not None:
        return []
    seen = [seen_in(clips, places, half) for half in halves(clips)]
    runners = []
    for restoring in ("none", "uniform", "trap"):
        model = Model(Law(size, restoring, "linear", turning=True), (Plane(size),))
        runners.append((model, [_begun(one, restoring, size) for one in seen]))
    return [x for x in with_friction_or_none(clips, runners) if _told(x)]


def _begun(seen: Sequence[Local], restoring: str, size: int) -> np.ndarray:
    """The law's numbers by least squares, in the order in which a law has them, and the starts."""
    s, v, a = joined(seen, "sva")
    columns = [np.broadcast_to(axis, s.shape) for axis in np.eye(size)]
    pulls = {"none": [], "uniform": columns, "trap": [-s, *columns]}[restoring]
    space = np.column_stack([v, np.zeros(len(v))])[:, :3]  # a plane lies in it
    about = np.eye(3)[2:] if size == 2 else np.eye(3)
    turned = [np.cross(axis, space)[:, :size] for axis in about]
    design = np.stack([x.ravel() for x in (*pulls, -v, *turned)], 1)
    numbers = np.linalg.lstsq(design, a.ravel(), rcond=None)[0]
    return np.concatenate([numbers, *map(start_of, seen)])


def _told(found: Fit) -> bool:
    """Whether the recording tells that the way is turned."""
    turns = [found.numbers[name] for name in found.model.law.turns]
    size = float(np.linalg.norm([value for value, _ in turns]))
    lasts = max(float(clip.times[-1]) for clip in found.clips)
    return max(error for _, error in turns) < VAGUE * size and size * lasts > LEAST
