"""Walls that one of several bodies bounces off alone, beside the meetings of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Model
from vidphys.diagnose.mechanisms.frames import Frames
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.impacts.kinks import Impact, find_impacts, seen_as, walls_of
from vidphys.diagnose.mechanisms.impacts.meetings import Meeting
from vidphys.diagnose.mechanisms.terms import Wall

MOST = 3  # walls
NEAR = 1.3  # times the distance at a meeting, within which an impact may be another meeting
APART = 1.5  # sides of a kink, by which an impact must be off from a meeting


def walled_apart(
    clips: Sequence[Frames],
    found: Sequence[Sequence[Meeting]],
    model: Model,
    along: np.ndarray | None,
) -> tuple[Model, dict[str, float]]:
    """The same law beside the walls that single bodies' impacts in the longest clip tell of.

    Args:
        clips: of all bodies.
        found: meetings of each clip.
        model: of the law without walls.
        along: of the line that the bodies keep to, if they do.

    Returns:
        The law, and numbers of its walls to begin at.
    """
    law, number = model.law, int(np.argmax([len(c.times) for c in clips]))
    assert isinstance(law, Colliding)
    struck = []
    for body, stretch in enumerate(clips[number].stretches):
        met = [x.time for x in found[number] if body in (x.one, x.two)]
        reach = max((x.distance for x in found[number] if body in (x.one, x.two)), default=0.0)
        impacts = [
            x
            for x in find_impacts(stretch.times, stretch.places)
            if all(_off(stretch.times, x.frame, t) > APART * x.side for t in met)
            and _to_others(clips[number], body, x) > NEAR * reach
        ]
        s = stretch.places if along is None else stretch.places @ along[:, None]
        struck += [(body, x) for x in walls_of(seen_as(impacts, stretch.times, s), s)]
    struck = sorted(struck, key=lambda x: -x[1].count)[:MOST]
    known: dict[str, float] = {}
    for i, (_, wall) in enumerate(struck, 1):
        known |= {f"wall {i}": wall.place, f"restitution {i}": wall.restitution}
        known |= {f"along {i}": wall.along}
    walls = tuple(Wall(tuple(wall.normal.tolist())) for _, wall in struck)
    beside = replace(law, walls=walls, bouncing=tuple(body for body, _ in struck))
    return Model(beside, model.charts), known


def _to_others(clip: Frames, body: int, impact: Impact) -> float:
    """Distance of the nearest other body at an impact of one."""
    own = clip.stretches[body]
    here, time = own.places[impact.frame], own.times[impact.frame]
    others = [x for i, x in enumerate(clip.stretches) if i != body]
    return min(
        float(np.linalg.norm(x.places[int(np.abs(x.times - time).argmin())] - here)) for x in others
    )


def _off(times: np.ndarray, frame: int, when: float) -> int:
    """Frames from one to a time."""
    return abs(int(np.searchsorted(times, when)) - 1 - frame)
