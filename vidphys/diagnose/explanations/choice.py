"""The one place where an explanation is chosen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vidphys.diagnose.diagnosis import Diagnosis, diagnose_motion, nothing_to_see
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.formula import ByFormula
from vidphys.diagnose.explanations.mechanism import ByMechanism
from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.standing import ODD, Standing, beside, status_of
from vidphys.diagnose.explanations.together import between_all, together
from vidphys.diagnose.explanations.verdict import EXPLAINED, MOST, MOSTLY, NOT, RANK
from vidphys.diagnose.mechanisms.impacts.strikes import strikes
from vidphys.diagnose.mechanisms.mechanism import MOST_BODIES, MOST_CLIPS
from vidphys.diagnose.recordings.motion import Motion, Unseen
from vidphys.diagnose.recordings.noise import Noise, measure_noise
from vidphys.diagnose.recordings.units import Units
from vidphys.progress import Progress

Maker = Callable[[Motion, int, bool, bool, Units], Explanation | None]
FITTED: tuple[Maker, ...] = (ByMechanism.of,)  # laws of the whole recording
NEARLY_ALL = 0.95  # of one body's motion, that laws explain so well that the menu is not asked
AS_WELL = 1.2  # times the error of what unseen places foretell: bodies that are seen come first
CLEARLY = 0.7  # of the error of what laws foretell, to which the menu or a formula must bring it


@dataclass(frozen=True)
class Understood:
    """What a recording shows.

    Args:
        found: the diagnosis by the menu, empty where it was not asked.
        explanation: ``None`` where there is nothing to explain.
        no_formula: why none was found, in a sentence, where one was sought; or empty.
    """

    found: Diagnosis
    explanation: Explanation | None
    no_formula: str = ""

    @property
    def status(self) -> str:
        """Of the verdict."""
        if self.explanation is None:
            return NOT
        return status_of(self.explanation, self.explanation.verdict)


def understand(
    motion: Motion,
    end: int,
    angles: bool = False,
    camera: bool = False,
    units: Units | None = None,
    progress: Progress | None = None,
) -> Understood:
    """What a recording shows: by laws fitted to the whole of it, by the menu, or by a formula.

    The menu is asked where the laws do not explain all, and believed where it foretells more; a
    formula is sought where neither explains anything, where the force is not quite theirs, or where
    something would have to add energy. What foretells more is told by the frames before the end
    alone.

    Args:
        motion: the whole recording.
        end: first frame that nothing is fitted to.
        angles: whether the coordinates are joint angles in radians.
        camera: whether places are in a picture, counted from its middle.
        units: in which lengths are told.
        progress: of the search for a formula.
    """
    units = units or Units()
    found, explanation = _known(motion, end, angles, camera, units)
    one = motion.bodies == 1 and motion.space == 1 and not motion.inputs
    known = None if explanation is None or not one else Standing.of(explanation)
    if explanation is None or known is None:
        return Understood(found, explanation)
    # a drive or a well is believed only where no formula foretells more
    odd = known.status == MOSTLY and bool({"drive", "well"} & set(explanation.kinds))
    if not (known.status == NOT or known.bent or odd):
        return Understood(found, explanation)
    sought = ByFormula.sought(motion, end, units, progress)
    if isinstance(sought, str):
        return Understood(found, explanation, sought)
    said = f"no formula: {sought.law.text} fits, but does not foretell"
    told, known = beside(sought, explanation)
    if told.status == NOT:
        said = f"{said} the last frames that it fits; a longer recording would tell"
        return Understood(found, explanation, said)
    if (known.bent or odd) and not told.error < CLEARLY * known.error:
        return Understood(found, explanation, f"{said} more than the law above")
    return Understood(found, sought)


def _known(
    motion: Motion, end: int, angles: bool, camera: bool, units: Units
) -> tuple[Diagnosis, Explanation | None]:
    """By laws, or by the menu, which knows of no inputs and no walls, and is not asked of such.

    Bodies that pass close by each other look as if something struck them, so of several that no
    law explains it is asked all the same. It is asked first where they seem to act on each other.
    """
    part = motion.cut(0, end)
    few = part.bodies <= MOST_BODIES and part.clips <= MOST_CLIPS
    struck = strikes(part) if few else []
    menu = None
    if few and not (camera or angles or struck or part.inputs) and together(part):
        menu = _by_menu(motion, end, units)
        if menu is not None and between_all(menu):
            return menu.found, menu
    laws = _best_of(FITTED, motion, end, angles, camera, units) if part.moves else None
    known = None if laws is None else Standing.of(laws)
    walled = bool(struck) and (part.bodies == 1 or (known is not None and known.status != NOT))
    if laws is not None and known is not None:
        enough = _enough(known, laws.one_law) and not laws.each_by_a_place
        if walled or part.inputs or enough:
            return Diagnosis(part, laws.noise or measure_noise(part), ""), laws
    try:
        noise, refused = measure_noise(part), nothing_to_see(part)
        if refused and (known is None or known.status == NOT):
            return Diagnosis(part, noise, refused), None
        if walled:
            return Diagnosis(part, noise, _said(struck, part.bodies)), None
        if part.inputs:
            said = f"no law beside the known {' and '.join(part.inputs[0].names)} fits"
            return Diagnosis(part, noise, said), None
        found = menu.found if menu else diagnose_motion(part, angles)
    except Unseen:
        if laws is None or not (laws.one_law or struck):
            raise
        return Diagnosis(part, laws.noise or Noise(np.nan, 0, np.nan, False), ""), laws
    if found.inference is None:
        return found, laws
    menu = menu or ByMenu(found, found.inference, motion, end, camera, units)
    if struck and not menu.explained:
        told = Diagnosis(part, noise, "" if laws else _said(struck, part.bodies))
        return told, laws
    return (found, menu) if laws is None or _foretells_more(menu, laws) else (found, laws)


def _by_menu(motion: Motion, end: int, units: Units) -> ByMenu | None:
    """What the menu says of a table; ``None`` where it can say nothing."""
    try:
        found = diagnose_motion(motion.cut(0, end))
    except Unseen:
        return None
    return ByMenu(found, found.inference, motion, end, False, units) if found.inference else None


def _best_of(
    makers: Sequence[Maker], motion: Motion, end: int, angles: bool, camera: bool, units: Units
) -> Explanation | None:
    """The one that foretells most, of those that can be fitted; the first of equals."""
    made = [make(motion, end, angles, camera, units) for make in makers]
    fitted = [(Standing.of(x), x) for x in made if x is not None]
    best = max(fitted, key=lambda x: (RANK.index(x[0].status), -x[0].error), default=None)
    return None if best is None else best[1]


def _enough(laws: Standing, one_law: bool) -> bool:
    """Whether the menu has nothing to add: one law has nearly all, or several foretell all."""
    if laws.status == EXPLAINED:
        return True
    if laws.verdict is None or laws.status != MOSTLY:
        return False
    nearly_all = laws.verdict.share > NEARLY_ALL
    return nearly_all if one_law else laws.verdict.foretells_all


def _said(struck: Sequence[tuple[int, float]], bodies: int) -> str:
    """Of bodies that are struck, where no law beside a wall could be fitted."""
    body, seconds = struck[0]
    who = "the body" if bodies == 1 else f"body {body + 1}"
    others = f" ({len(struck)} strikes in all)" if len(struck) > 1 else ""
    return (
        f"something strikes {who} at {seconds:.4g} s{others}, and no law beside a wall fits; cut "
        "the recording there, or follow what strikes it too"
    )


def _foretells_more(menu: ByMenu, laws: Explanation) -> bool:
    """Whether the menu's terms are to be believed rather than laws."""
    told, known = beside(menu, laws)
    if laws.each_by_a_place and menu.explained and "pair" in menu.kinds:
        return not told.error > AS_WELL * known.error
    if told.verdict is None:
        # Nothing was held out, or what it says cannot be rolled: a bath, a law that changes. Such
        # terms are believed only where nothing smooth explains as much.
        odd = bool(menu.inference.kicks or menu.found.parts)
        return menu.explained and (known.status == NOT or not (odd or laws.one_law))
    if ODD & set(menu.kinds) and known.status != NOT:
        return False  # what adds energy is believed only where nothing smooth explains as much
    rank, other = RANK.index(told.status), RANK.index(known.status)
    if rank != other:
        return rank > other
    if told.status == NOT and known.verdict is not None and known.verdict.share >= MOST:
        return False  # neither explains all: the plainer is told
    return told.error < CLEARLY * known.error
