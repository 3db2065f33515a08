"""Candidate bodies whose corners move as one; for those that no background shows whole."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from binders.base import Pictures
from binders.hypotheses import Hypothesis
from binders.lawful import foretold
from binders.outline import outlined
from binders.points import Group, carried, groups

STIRRED = 25.0  # grey levels between its darkest and brightest, from which a pixel changes
LIKELIEST = 10  # groups of corners that are looked at
SHADOW = 0.9  # of it that changes in brightness alone
FEW = 2.0  # corners that may go together by chance
LESSER = 0.75  # of a body's size: what is smaller and goes as bodies do is what holds them
HELD = 0.8  # of its frames, in which a part of a body is at it
DRAWN = 0.98  # of its motion, that is explained by theirs


def carried_bodies(
    frames: Pictures,
    sample: list[int],
    background: Float[np.ndarray, "h w 3"],
    changed: Pictures,
    times: Float[np.ndarray, " t"],
    inside: Bool[np.ndarray, "h w"] | None,
) -> list[tuple[Hypothesis, float]]:
    """What moves as one with its corners, and how sure that is, at most 1.

    Args:
        frames: before a still camera.
        sample: frames that tell what changes in the course of the clip.
        background: what stands still in them.
        changed: what differs from the background in more than brightness.
        times: of each frame, in units of the usual interval.
        inside: where bodies are looked for; ``None`` where that is everywhere.
    """
    some = frames[sample]
    stirred = (some.max(0).astype(float) - some.min(0)).max(-1) > STIRRED
    if inside is not None:
        stirred &= inside
    found = list(groups(carried(frames, stirred), float(min(frames.shape[1:3]))))
    found.sort(key=lambda group: -_lawful(group, times))
    bodies = []
    for group in found[:LIKELIEST]:
        body = outlined(group.positions, frames, background, changed)
        if body is not None and np.nanmedian(body.lit) < SHADOW:
            bodies.append((body, _sure(group)))
    return bodies


def _lawful(group: Group, times: np.ndarray) -> float:
    seen = np.isfinite(group.positions[:, 0]).mean()
    return float(foretold(group.positions, times) * seen**0.6 * _sure(group))


def _sure(group: Group) -> float:
    return group.corners / (group.corners + FEW)


def drawn_along(one: Hypothesis, others: list[Hypothesis]) -> bool:
    """Whether something small goes as one or two larger ones do, as the coils of a spring.

    It goes the same share of their way whichever way they go, or is at one of them all the time, as
    a mark on it. What is struck goes another way, as another linear map of what strikes it.
    """
    size = one.usual_size
    larger = [other for other in others if size < LESSER * other.usual_size]
    at = [_at(one, other) > HELD for other in larger]
    for k, first in enumerate(larger):
        for j, second in enumerate(larger[k:], k):
            both = one.seen & first.seen & second.seen
            if both.sum() < 0.5 * one.seen.sum():
                continue
            target, *ways = (_way(each, both) for each in (one, first, second))
            if _explains(np.stack([way.ravel() for way in ways], 1), target.reshape(-1, 1)):
                return True
            if (at[k] or at[j]) and _explains(np.hstack(ways), target):
                return True
    return False


def _way(body: Hypothesis, seen: np.ndarray) -> np.ndarray:
    """Its places about their middle."""
    places = body.positions[seen]
    return np.asarray(places - places.mean(0))


def _at(one: Hypothesis, other: Hypothesis) -> float:
    """Share of its frames in which one is within the size of another."""
    apart = np.linalg.norm(one.positions - other.positions, axis=-1)
    return float((apart < other.usual_size).sum() / max(one.seen.sum(), 1))


def _explains(design: np.ndarray, target: np.ndarray) -> bool:
    gram, moment = design.T @ design, design.T @ target
    least = np.finfo(float)  # of what two tell, that go as one, or that stand
    ridge = (least.eps * np.trace(gram) + least.tiny) * np.eye(len(gram))
    explained = float((moment * np.linalg.solve(gram + ridge, moment)).sum())
    return explained > DRAWN * float((target**2).sum())
