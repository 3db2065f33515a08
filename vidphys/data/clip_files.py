"""Clips where they lie, with what is known of each; a data set is several that belong together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from vidphys.data.formats.base import Frames
from vidphys.data.labels import Labels
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256

if TYPE_CHECKING:
    from dynamics import Parameters

Fact = str | int | float | bool
Decoded = tuple[float, int, Frames]  # frames a second and count, as declared, and the frames


@dataclass(frozen=True)
class Source:
    """A clip that is no file of its own.

    Args:
        read: its frames, see :class:`vidphys.data.formats.ClipFormat`.
        sha256: of its content.
        made_by: the package whose decoder makes the frames.
    """

    read: Callable[[], Decoded]
    sha256: Callable[[], str]
    made_by: str


@dataclass(frozen=True)
class ClipFile:
    """One clip on disk.

    Args:
        path: the video.
        labels: where its bodies are, if that is known.
        coupling: G of the law that held.
        mass: of each body; ones where nothing is said.
        truth: what else is known of its frames, if there is something.
        facts: what else is known of it, by name; one of them may say which clips belong together.
        split: that its data set puts it into, such as train; empty where it says nothing.
        source: of its frames, where ``path`` is no file: the data set's, then its name therein.
    """

    path: Path
    labels: Labels | None = None
    coupling: float = 1.0
    mass: tuple[float, ...] | None = None
    truth: Labels | None = None
    facts: Mapping[str, Fact] = field(default_factory=dict)
    split: str = ""
    source: Source | None = None

    def law(self, bodies: int) -> Parameters:
        """What a head is told of the clip, batch of one.

        Raises:
            InputError: masses of another number of bodies.
        """
        import torch

        from dynamics import Parameters

        mass = (1.0,) * bodies if self.mass is None else self.mass
        if len(mass) != bodies:
            raise InputError(
                f"{self.path}: {bodies} bodies, but its data set has {len(mass)} masses"
            )
        return Parameters(torch.tensor([self.coupling]), torch.tensor([mass]))


@dataclass(frozen=True)
class Dataset:
    """Clips that belong together.

    Args:
        files: in the order of their names, at least one.
        half_extent: units of the labels' x and y in half of the longer image side.
        identical: bodies look alike.
        conserving: there is no friction in it.
        columns: what columns of the labels are, where their names do not tell.
        stored: the files that hold clips which are no files of their own.
    """

    files: tuple[ClipFile, ...]
    half_extent: float = 1.0
    identical: bool = False
    conserving: bool = False
    columns: Mapping[str, str] = field(default_factory=dict)
    stored: tuple[Path, ...] = ()

    @property
    def labelled(self) -> bool:
        """Whether tables tell the positions; else they are followed by what moves."""
        return self.files[0].labels is not None

    @property
    def hashes(self) -> dict[str, str]:
        """SHA-256 of every file."""
        often = Counter(path.name for path in self.paths)
        return {p.name if often[p.name] == 1 else str(p): sha256(p) for p in self.paths}

    @property
    def paths(self) -> list[Path]:
        """Of the clips and their labels."""
        found = list(self.stored)
        for file in self.files:
            found += [file.path] if file.source is None else []
            found += [] if file.labels is None or file.labels.path is None else [file.labels.path]
        return found

    def told(self, bodies: int) -> str:
        """Where positions come from, for a person."""
        counted = f"({bodies} bod{'y' if bodies == 1 else 'ies'})"
        named = (file.labels.name for file in self.files if file.labels is not None)
        tables = list(dict.fromkeys(named))
        if not tables:
            return f"labels: none, following motion {counted}"
        more = f" and {len(tables) - 1} more" if len(tables) > 1 else ""
        return f"labels: {tables[0]}{more} {counted}"
