"""Blobs of each frame to bodies that keep identity, by the least acceleration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import linear_sum_assignment

REACH = 4.0
LONGEST_COAST = 5  # frames in a row in which a body that is not seen goes on
STARTS = 8  # parts of the clip in which it is tried to begin
FAINT = 0.15
STRONG = 0.5  # of the usual energy of what is followed: as strong is no shadow of it


@dataclass(frozen=True)
class Blobs:
    """Candidate bodies of one frame.

    Args:
        centre: ``(k, 2)``, (x, y) in pixels, y downwards.
        energy: how much changed there, ``(k,)``, arbitrary unit.
        radius: of the disc of the same area, pixels, ``(k,)``.
    """

    centre: Float[np.ndarray, "k 2"]
    energy: Float[np.ndarray, " k"]
    radius: Float[np.ndarray, " k"]


@dataclass(frozen=True)
class Path:
    """Bodies followed through the clip.

    Args:
        positions: ``(t, n, 2)`` pixels; interpolated in time where a body was not seen.
        confidence: ``(t, n)``: energy of the blob relative to the body's median, at most 1; 0
            where it was not seen.
        radius: median radius of the blobs that were taken, pixels.
        others: share of the frames in which a blob that is as strong is not followed.
    """

    positions: Float[np.ndarray, "t n 2"]
    confidence: Float[np.ndarray, "t n"]
    radius: float
    others: float


def follow(blobs: list[Blobs], bodies: int) -> Path:
    """Follow the ``bodies`` strongest blobs of a frame to both ends of the clip.

    A body takes the blob nearest to where it would be without acceleration, within a reach of
    four radii plus twice what it has moved since it was seen (it may bounce); the stronger blob is
    preferred, and one far fainter than the body has been is not the body. Of several starts, the
    clearest frame of each part of the clip, the one counts whose bodies are seen most, beside what
    else moves.

    Raises:
        ValueError: there is no frame with so many blobs.
    """
    clearest = [np.sort(b.energy)[-bodies] if len(b.energy) >= bodies else 0.0 for b in blobs]
    if not any(clearest):
        raise ValueError(
            f"follow: no frame shows {bodies} moving bodies that its edge does not cut; check the "
            "number of bodies, or keep changes of brightness (shadow 1)"
        )
    clear = STRONG * np.median([energy for energy in clearest if energy])
    parts = np.array_split(range(len(blobs)), min(STARTS, len(blobs)))
    starts = [int(max(part, key=clearest.__getitem__)) for part in parts]
    found = [_followed(blobs, bodies, start) for start in starts if clearest[start] >= clear]
    return _gather(blobs, max(found, key=lambda chosen: _seen(blobs, chosen)))


def _followed(blobs: list[Blobs], bodies: int, start: int) -> np.ndarray:
    """Number of each body's blob, ``(t, n)``; -1 where it has none."""
    chosen = np.full((len(blobs), bodies), -1)
    chosen[start] = np.argsort(-blobs[start].energy)[:bodies]
    _walk(blobs, chosen, range(start + 1, len(blobs)), start)
    _walk(blobs, chosen, range(start - 1, -1, -1), start)
    return chosen


def _seen(blobs: list[Blobs], chosen: np.ndarray) -> float:
    """Frames in which the bodies are seen, each by its energy over that of the strongest blob."""
    return sum(
        float(blob.energy[mine[mine >= 0]].sum() / blob.energy.max())
        for blob, mine in zip(blobs, chosen, strict=True)
        if len(blob.energy)
    )


def _walk(blobs: list[Blobs], chosen: np.ndarray, order: range, start: int) -> None:
    """Fill ``chosen`` frame by frame in ``order``; -1 where a body has no blob."""
    here = blobs[start].centre[chosen[start]]
    radius = blobs[start].radius[chosen[start]]
    energy = blobs[start].energy[chosen[start]]
    speed = np.zeros_like(here)
    fastest = np.zeros(len(here))
    unseen = np.zeros(len(here))
    for frame in order:
        here = here + speed
        fastest = np.where(unseen > LONGEST_COAST, fastest, np.linalg.norm(speed, axis=-1))
        reach = REACH * radius + 2 * fastest * (1 + unseen)
        found = _assign(blobs[frame], here, reach, FAINT * energy)
        seen = found >= 0
        new = np.where(seen[:, None], blobs[frame].centre[found], here) if seen.any() else here
        # a half step towards the new speed: single centroids are noisy
        correction = (new - here) / (1 + unseen[:, None])
        speed = np.where(seen[:, None], speed + correction, speed)
        speed[unseen > LONGEST_COAST] = 0
        if seen.any():
            energy = np.where(seen, 0.9 * energy + 0.1 * blobs[frame].energy[found], energy)
        here, unseen = new, np.where(seen, 0, unseen + 1)
        chosen[frame] = found


def _assign(
    blobs: Blobs, predicted: np.ndarray, reach: np.ndarray, faintest: np.ndarray
) -> np.ndarray:
    """Blob of each body, or -1: distance over reach, less the blob's share of the energy."""
    found = np.full(len(predicted), -1)
    if len(blobs.energy) == 0:
        return found
    distance = np.linalg.norm(predicted[:, None] - blobs.centre[None], axis=-1) / reach[:, None]
    out = (distance > 1) | (blobs.energy[None] < faintest[:, None])
    cost = np.where(out, 1e6, distance - blobs.energy / blobs.energy.max())
    for body, blob in zip(*linear_sum_assignment(cost), strict=True):
        if cost[body, blob] < 1e6:
            found[body] = blob
    return found


def _gather(blobs: list[Blobs], chosen: np.ndarray) -> Path:
    frames, bodies = chosen.shape
    positions = np.zeros((frames, bodies, 2))
    confidence = np.zeros((frames, bodies))
    radii, energies = [], []
    for body in range(bodies):
        seen = np.nonzero(chosen[:, body] >= 0)[0]
        taken = [(blobs[t], chosen[t, body]) for t in seen]
        centre = np.array([b.centre[k] for b, k in taken])
        energy = np.array([b.energy[k] for b, k in taken])
        radii += [b.radius[k] for b, k in taken]
        for axis in (0, 1):
            positions[:, body, axis] = np.interp(np.arange(frames), seen, centre[:, axis])
        energies.append(np.median(energy))
        confidence[seen, body] = np.minimum(1.0, energy / energies[-1])
    strong = STRONG * min(energies)
    others = [
        (np.delete(blob.energy, mine[mine >= 0]) > strong).any()
        for blob, mine in zip(blobs, chosen, strict=True)
    ]
    return Path(positions, confidence, float(np.median(radii)), float(np.mean(others)))
