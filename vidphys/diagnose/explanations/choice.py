"""The one place where an explanation is chosen."""

from __future__ import annotations

from collections.abc import Callable

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.explanations.explanation import Explanation
from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.wall import ByWall
from vidphys.diagnose.recordings.motion import Motion

BEYOND_THE_MENU: tuple[Callable[[Motion, int], Explanation | None], ...] = (ByWall.of,)


def explain(found: Diagnosis, motion: Motion, end: int) -> Explanation | None:
    """The menu, or where it explains nothing or only by random kicks, the first that does more.

    Args:
        found: of the motion before ``end``.
        motion: the whole recording.
        end: first frame that nothing is fitted to.

    Returns:
        ``None`` where there is nothing to explain.
    """
    if found.inference is None:
        return None
    if not found.explained or found.inference.kicks:
        for fit in BEYOND_THE_MENU:
            other = fit(motion, end)
            if other is not None:
                return other
    return ByMenu(found, found.inference, motion, end)
