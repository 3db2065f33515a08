"""Whether bodies act on each other: what is asked of two or more before laws of each are fitted."""

from __future__ import annotations

from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.standing import ODD, Standing
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.impacts.collisions import parties
from vidphys.diagnose.mechanisms.mechanism import first_alone
from vidphys.diagnose.mechanisms.rods import at_one_distance
from vidphys.diagnose.recordings.balance import masses_in_balance
from vidphys.diagnose.recordings.motion import Motion


def together(part: Motion) -> bool:
    """Whether bodies seem to act on each other: their centre shows it, or no law of one alone comes
    near to what the first does.

    Bodies that meet do so too, for a moment: theirs is a collision's law, before any force.
    """
    if part.bodies == 1 or not part.moves or parties(frames_of(part)):
        return False
    return masses_in_balance(part) is not None or not first_alone(part)


def between_all(menu: ByMenu) -> bool:
    """Whether a force between bodies explains all, and foretells it.

    Of two that circle each other at one distance, about a centre that goes straight on, it need not
    be sure which force does so.
    """
    plain = "pair" in menu.kinds and not ODD & set(menu.kinds)
    if not (plain and menu.explained):
        return False
    told = Standing.of(menu)
    if told.status == EXPLAINED:
        return True
    motion = menu.found.motion
    circling = (motion.clips, motion.bodies) == (1, 2) and at_one_distance(motion)
    foretells = told.verdict is not None and told.verdict.foretells_all
    return circling and foretells and masses_in_balance(motion) is not None
