"""What a rollout has to say about itself: named warnings, and findings kept with the result."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

from torch import Tensor


class DynamicsWarning(RuntimeWarning):
    """A rollout may not be what it seems; the subclasses say why."""


class StabilityWarning(DynamicsWarning):
    """The step is too long for the fastest term, which is named."""


class EnergyWarning(DynamicsWarning):
    """A model that conserves its energy did not."""


class DomainWarning(DynamicsWarning):
    """A learned model was asked about states far outside those it was trained on."""


class RoundingWarning(DynamicsWarning):
    """Positions are so far from the origin that their rounding hides how the bodies move."""


class OverlapWarning(DynamicsWarning):
    """Hard bodies overlap at the start: their collisions are not defined."""


class FailureWarning(DynamicsWarning):
    """A state is not finite; step, body and term are named."""


class NoSteadyState(DynamicsWarning):
    """Net damping is not positive: the energy of what is about to be rolled grows for ever."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a rollout.

    Args:
        kind: the warning's category.
        text: the warning's text.
        episodes: which, boolean, batch shape.
        step: the first step that shows it, of the first such episode, where there is one.
        body: index of the body, or of the first of a pair.
        term: name of the term of the model.
    """

    kind: type[DynamicsWarning]
    text: str
    episodes: Tensor
    step: int | None = None
    body: int | None = None
    term: str | None = None

    def warn(self) -> None:
        """Raise the warning."""
        warnings.warn(self.text, self.kind, stacklevel=3)


def counted(episodes: Tensor) -> str:
    """``"3 of 64 episodes"``, or ``"the episode"``."""
    if episodes.ndim == 0:
        return "the episode"
    return f"{int(episodes.sum())} of {episodes.numel()} episodes"


def first(episodes: Tensor) -> tuple[int, ...]:
    """Batch index of the first episode that is concerned."""
    return tuple(episodes.nonzero()[0].tolist())
