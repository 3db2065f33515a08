"""How many bodies there are, and how far their identities can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.recordings.motion import Motion

JUMP = 8.0  # times the usual change of a step, from which a step counts as a jump


@dataclass(frozen=True)
class Identity:
    """Bodies and their names.

    Args:
        bodies: how many.
        seen: share of frames in which each was seen, ``(n,)``.
        crossings: frames in which two bodies were nearer than they move in a frame, so that a
            tracker could have taken one for the other.
        jumps: steps of a body that differ from its last one far more than usual.
        why: one sentence.
    """

    bodies: int
    seen: np.ndarray
    crossings: int
    jumps: int
    why: str

    @property
    def holds(self) -> bool:
        """Whether nothing speaks against the identities."""
        return self.crossings == 0 and self.jumps == 0


def check_identity(motion: Motion) -> Identity:
    """Look for frames in which bodies may have been mistaken for each other."""
    q, seen = motion.positions, motion.seen
    steps = np.diff(q, axis=1)
    change = np.linalg.norm(np.diff(steps, axis=1), axis=-1)
    usual = float(np.nanmedian(change)) if np.isfinite(change).any() else 0.0
    length = float(np.nanmedian(np.linalg.norm(steps, axis=-1)))
    # A body that jumps there and back changes its step by more than it usually moves in all.
    jumps = int(np.nansum(change > max(JUMP * usual, 2 * length))) if usual > 0 else 0
    crossings = 0
    if motion.bodies > 1:
        i, j = np.triu_indices(motion.bodies, 1)
        apart = np.linalg.norm(q[:, :, i] - q[:, :, j], axis=-1)
        crossings = int(np.nansum((apart < length).any(-1)))
    share = seen.mean((0, 1))
    return Identity(motion.bodies, share, crossings, jumps, _said(motion, share, crossings, jumps))


def _said(motion: Motion, share: np.ndarray, crossings: int, jumps: int) -> str:
    noun, each = ("body", "") if motion.bodies == 1 else ("bodies", "each ")
    least = share.min()
    often = "every frame" if least == 1 else f"{min(least, 0.994):.0%} of the frames"
    text = f"{motion.bodies} {noun}, {each}seen in {often}" + (
        " or more" if each and least < 1 else ""
    )
    if crossings:
        text += f"; in {crossings} frames two are nearer than a step: names may have been swapped"
    if jumps:
        text += f"; jumps: {jumps}"
    return text
