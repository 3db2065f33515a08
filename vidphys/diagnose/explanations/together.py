"""Whether bodies act on each other: what is asked of two or more before laws of each are fitted."""

from __future__ import annotations

from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.standing import ODD, Standing
from vidphys.diagnose.explanations.verdict import EXPLAINED
from vidphys.diagnose.mechanisms.mechanism import first_alone
from vidphys.diagnose.recordings.balance import masses_in_balance
from vidphys.diagnose.recordings.motion import Motion


def together(part: Motion) -> bool:
    """Whether bodies seem to act on each other: their centre shows it, or no law of one alone comes
    near to what the first does.
    """
    if part.bodies == 1 or not part.moves:
        return False
    return masses_in_balance(part) is not None or not first_alone(part)


def between_all(menu: ByMenu) -> bool:
    """Whether a force between bodies explains all, and foretells it.

    Of bodies that keep a balance of their masses it need not be sure which force does so.
    """
    plain = "pair" in menu.kinds and not ODD & set(menu.kinds)
    if not (plain and menu.explained):
        return False
    told = Standing.of(menu)
    if told.status == EXPLAINED:
        return True
    foretells = told.verdict is not None and told.verdict.foretells_all
    return foretells and masses_in_balance(menu.found.motion) is not None
