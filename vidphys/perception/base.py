"""What every way of seeing has in common: it is fitted to clips, and it gives tracks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, is_dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from torch import Tensor

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


@runtime_checkable
class Looking(Perception, Protocol):
    """A perception that can tell what its readout attends to."""

    def attention(self, clips: Clips) -> Tensor | None:
        """How much each cell counts for each body in every frame of a clip ``(t, n, h, w)``.

        Args:
            clips: one alone.
        """
        ...


# Supervision: what told a perception where bodies are.
STATES, LABELS, UNTOLD = "true states", "labels", "none"
CENTROIDS, TRACKER, DETECTOR = "anchor: centroids", "anchor: tracker", "anchor: detector"
# What a perception, or what anchors it, knows of how its pictures are drawn.
NOTHING, CHANNELS, BODY = "nothing", "channels", "channels, exact body"
DISK, COLOURS, BLOBS = "exact disk", "exact disk, colours, depth", "blobs"
REDRAWS = "draws encounters"  # of true paths, to learn from


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
        device: where to train and to look.
    """

    clips: Clips
    sizes: PixelSizes
    seed: int
    head: str
    folder: Path | None = None
    progress: Progress | None = None
    device: str = "cpu"


@dataclass(frozen=True)
class Grounding:
    """One rung of the ladder.

    Args:
        name: as in the records.
        world: key of ``renderers.WORLDS``.
        encoder, binder: names for the record, ``none`` where there is none.
        joint: whether fitting involves the head, so that each head needs its own.
        fit: does it, given the task; what else it is given are the rung's settings.
        supervision: what tells it where bodies are, see :data:`LABELS`.
        knows: of how pictures are drawn, see :data:`DISK`.
        share: the rung is given the preset's training clips over this.
        of: the rung that this one is a variant of, whose clips and random streams it has; none for
            a rung of its own.
    """

    name: str
    world: str
    encoder: str
    binder: str
    joint: bool
    fit: Callable[[FitTask], Perception]
    supervision: str
    knows: str
    share: int = 1
    of: str = ""

    @property
    def identified(self) -> bool:
        """Whether its pictures say who is who."""
        return self.world != "anonymous"

    def told(self, clips: int) -> str:
        """Its supervision, for the record: with how many clips have labels."""
        return f"{LABELS} of {clips} clips" if self.supervision == LABELS else self.supervision

    def varied(
        self, name: str, supervision: str = "", knows: str = "", **settings: object
    ) -> Grounding:
        """The same rung with other settings of its fit.

        Args:
            name: of the variant, after a dash.
            supervision, knows: the rung's own where not given.
            settings: by keyword.
        """
        return replace(
            self,
            name=f"{self.name}-{name}",
            fit=partial(self.fit, **settings),
            supervision=supervision or self.supervision,
            knows=knows or self.knows,
            of=self.of or self.name,
        )

    @property
    def settings(self) -> dict[str, Any]:
        """All that ``fit`` is given beside the task, bound or by default, as plain data."""
        fit = self.fit if isinstance(self.fit, partial) else partial(self.fit)
        given = signature(fit.func).bind_partial(*fit.args, **fit.keywords)
        given.apply_defaults()
        return {k: asdict(v) if is_dataclass(v) else v for k, v in given.arguments.items()}  # type: ignore[arg-type]
