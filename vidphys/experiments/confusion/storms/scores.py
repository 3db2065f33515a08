"""How answers to the harder scenes are scored; what is said surely and is wrong counts most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.experiments.confusion.scores import Answer


@dataclass(frozen=True)
class Scored:
    """One scene with an answer to it.

    Args:
        name: of the class.
        truth: kinds of terms; ``None`` where the menu has no such scene.
        answer: a method's.
    """

    name: str
    truth: frozenset[str] | None
    answer: Answer

    @property
    def exact(self) -> bool:
        """Precisely the scene's terms, or "none of these" where the menu lacks one."""
        if self.truth is None:
            return not self.answer.explained
        return self.answer.explained and self.answer.kinds == self.truth

    @property
    def sure_and_wrong(self) -> bool:
        """Told without a doubt, and not so; a false "none of these" among them."""
        return self.answer.sure and not self.exact


def ours(found: Diagnosis) -> Answer:
    """The diagnosis; a switch is one more claim, which no scene has; a refusal tells nothing."""
    if found.refused:
        return Answer(frozenset(), sure=False)
    switch = frozenset({"switch"}) if found.parts else frozenset()
    return Answer(found.kinds | switch, found.explained, found.told)


def scores(scored: Sequence[Scored]) -> dict[str, list[bool]]:
    """For every question, the scenes of which it is asked, answered by yes or no."""
    menu = [s for s in scored if s.truth is not None]
    outside = [s for s in scored if s.truth is None]
    return {
        "exact_structure": [s.exact for s in scored],
        "exact_and_sure": [s.exact and s.answer.sure for s in scored],
        "sure_and_wrong": [s.sure_and_wrong for s in scored],
        "not_told": [not s.answer.sure for s in scored],
        "exact_structure_menu": [s.exact for s in menu],
        "false_alarm": [not s.answer.explained for s in menu],
        "outside_refused": [s.exact for s in outside],
        "outside_sure_and_wrong": [s.sure_and_wrong for s in outside],
    }
