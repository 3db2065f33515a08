"""What every way of seeing has in common: it is fitted to clips, and it gives tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, is_dataclass
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from binders import Tracks
from dynamics import Head
from vidphys.data.clips import Clips
from vidphys.presets import PixelSizes
from vidphys.progress import Progress


class Perception(Protocol):
    """Frames to tracks. A fitted perception is frozen: the same clip gives the same tracks."""

    def tracks(self, clips: Clips) -> Tracks:
        """Positions in world units of every body in every frame."""
        ...


@runtime_checkable
class Foreseeing(Perception, Protocol):
    """A perception that follows bodies better where it is told the law of their motion."""

    def under(self, head: Head) -> Perception:
        """The same perception with a trained head to foresee each next frame."""
        ...


@runtime_checkable
class Attentive(Perception, Protocol):
    """A perception that reads a clip better at several times the cost."""

    def closely(self, clips: Clips) -> Tracks:
        """As :meth:`tracks`, for the few clips that something is asked about."""
        ...


@dataclass(frozen=True)
class FitTask:
    """What a perception is fitted to.

    Args:
        clips: training clips; their ``states`` may be read by a supervised grounding only.
        sizes: of the preset.
        seed: of initial weights and batch order.
        head: name of the dynamics head, for perceptions that are trained through one.
        folder: for checkpoints, or ``None``.
        progress: called as ``(step, steps, loss)``.
    """

    clips: Clips
    sizes: PixelSizes
    seed: int
    head: str
    folder: Path | None = None
    progress: Progress | None = None


@dataclass(frozen=True)
class Grounding:
    """One rung of the ladder.

    Args:
        name: as in the records.
        world: key of ``renderers.WORLDS``.
        encoder, binder: names for the record, ``none`` where there is none.
        joint: whether fitting involves the head, so that each head needs its own.
        fit: does it, given the task; what else it is given are the rung's settings.
        share: the rung is given the preset's training clips over this.
        whole_context: the clips that end at t0 are as long as the training clips, for encoders
            that see a whole clip at once.
    """

    name: str
    world: str
    encoder: str
    binder: str
    joint: bool
    fit: Callable[[FitTask], Perception]
    share: int = 1
    whole_context: bool = False

    @property
    def settings(self) -> dict[str, Any]:
        """All that ``fit`` is given beside the task, bound or by default, as plain data."""
        fit = self.fit if isinstance(self.fit, partial) else partial(self.fit)
        given = signature(fit.func).bind_partial(*fit.args, **fit.keywords)
        given.apply_defaults()
        return {k: asdict(v) if is_dataclass(v) else v for k, v in given.arguments.items()}  # type: ignore[arg-type]
