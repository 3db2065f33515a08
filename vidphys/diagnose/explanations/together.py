"""Whether bodies act on each other: what is asked of two or more before laws of each are fitted."""

from __future__ import annotations

from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.standing import ODD, Standing
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.frames import frames_of
from vidphys.diagnose.mechanisms.impacts.collisions import parties
from vidphys.diagnose.mechanisms.mechanism import first_alone
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
    """Whether a force between bodies explains all, and foretells it."""
    plain = "pair" in menu.kinds and not ODD & set(menu.kinds)
    return plain and menu.explained and Standing.of(menu).status == EXPLAINED
