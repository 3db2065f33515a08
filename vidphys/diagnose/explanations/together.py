"""Whether bodies act on each other: what is asked of two or more before laws of each are fitted."""

from __future__ import annotations

import numpy as np

from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.standing import ODD, Standing
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.impacts.collisions import parties
from vidphys.diagnose.mechanisms.mechanism import first_alone
from vidphys.diagnose.recordings.balance import about_a_heavy_one, masses_in_balance
from vidphys.diagnose.recordings.motion import Motion

WIDE = 0.15  # of how far a body moves along its longest way, that it moves across it at least


def together(part: Motion) -> bool:
    """Whether bodies seem to act on each other: their centre shows it, one hardly moves, or no law
    of one alone comes near to what the first does.

    Bodies that meet do so too, for a moment: theirs is a collision's law, before any force.
    """
    if part.bodies == 1 or not part.moves or parties(frames_of(part)):
        return False
    heavy = about_a_heavy_one(part) is not None
    return heavy or masses_in_balance(part) is not None or not first_alone(part)


def between_all(menu: ByMenu) -> bool:
    """Whether a force between bodies explains all, and foretells it.

    Of bodies that move to and fro along a way each, as coupled pendulums do, a law of them is asked
    too where the force may be another.
    """
    if "pair" not in menu.kinds or ODD & set(menu.kinds) or not menu.explained:
        return False
    told = Standing.of(menu)
    foretold = told.verdict is not None and told.verdict.foretells_all
    return told.status == EXPLAINED or (foretold and _goes_about(menu.motion))


def _goes_about(motion: Motion) -> bool:
    """Whether each body of each clip moves along more than one way."""
    for path in np.moveaxis(motion.positions, 2, 1).reshape(-1, *motion.positions.shape[1::2]):
        seen = path[np.isfinite(path).all(-1)]
        sizes = np.linalg.svd(seen - seen.mean(0), compute_uv=False)
        if len(sizes) < 2 or sizes[1] < WIDE * sizes[0]:
            return False
    return True
