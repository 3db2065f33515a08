"""Which of several fitted laws the evidence is for; of those nearly as likely, the plainest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.sense import goes_one_way

# of log likelihood after its price, by which a law must be better than a plainer one
LIKELIER = 4.0
# of log likelihood, by which a pull that only slows what coasts must be better than dry friction:
# in clips filmed for development it was better by up to 9 where there was dry friction
COASTING = 12.0
LEVEL = 2.0  # times its height, that a way is wide which is level, nearly


def ranked(fits: Sequence[Fit]) -> list[Fit]:
    """Best first; of those that are nearly as likely, the plainest."""
    ordered = sorted(fits, key=lambda x: -x.score)
    if not ordered:
        return []
    clear = COASTING if _only_pulled_back(ordered[0]) else LIKELIER
    near = [x for x in ordered if x.score > ordered[0].score - clear]
    plainest = min(near, key=_plain)
    return [plainest, *(x for x in ordered if x is not plainest)]


def _plain(found: Fit) -> tuple[int, int]:
    """How much a law asks for: its numbers, and what would be a coincidence.

    What swings slowly loses by a friction that goes with its speed, what falls through air by one
    that goes with its square. A pull straight against a motion that it never turns round is rarer
    than dry friction.
    """
    law = found.model.law
    if law.restoring == "none" or (law.curve is not None and goes_one_way(found)):
        return len(found.covariance), 0
    swings = law.restoring in ("trap", "pendulum") or law.curve is not None
    usual = "linear" if swings else "square"
    odd = law.friction not in ("none", usual) or _only_pulled_back(found)
    return len(found.covariance), int(odd)


def _only_pulled_back(found: Fit) -> bool:
    """Whether a constant pull only slows what coasts."""
    return found.model.law.restoring == "uniform" and _coasts(found)


def _coasts(found: Fit) -> bool:
    """Whether a body in a picture gets slower on its level way, and never turns round."""
    if not found.model.law.pictured or found.model.law.walls:
        return False
    paths = [s.places for clip in found.clips for s in clip.stretches]
    across, up = np.abs(np.concatenate([p - p[0] for p in paths])).max(0)
    rates = np.concatenate([x[:, 1] for x in found.model.coordinates(found.values, found.clips)])
    speed, ahead = np.linalg.norm(rates, axis=-1), rates @ rates[0]
    return bool(across > LEVEL * up and (np.diff(speed) <= 0).all() and (ahead >= 0).all())
