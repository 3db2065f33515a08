"""What is known of the clips of a probe, in the frames that are read: plain numbers, no files."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from vidphys.data.splits import refuse_leaks
from vidphys.errors import InputError
from vidphys.probing.targets import Labels
from vidphys.probing.truth import Track


@dataclass(frozen=True)
class Bodies:
    """Where the bodies are in the frames that are read.

    Args:
        track: in world units.
        places: in the picture, ``(e, n, 2)``, as :class:`vidphys.probing.readouts.Local` wants
            them.
    """

    track: Track
    places: Tensor


@dataclass(frozen=True)
class Known:
    """See the module.

    Args:
        labels: values of the targets.
        left_out: why nothing can be learned of the others, by target.
        groups: number of each clip's group, from 0, ``(clips,)``; those of a group are tested
            together.
        bodies: where they are, or why that is not known.
        about: how each clip was read, for a record.
        columns: that can be asked for by ``column:``, ``angle:`` or ``class:`` and their name.
    """

    labels: tuple[Labels, ...]
    left_out: Mapping[str, str]
    groups: np.ndarray
    bodies: Bodies | str
    about: tuple[Mapping[str, Any], ...] = ()
    columns: tuple[str, ...] = ()

    def require(self, folds: int, where: object = "probe") -> None:
        """Refuse what cannot be asked.

        Args:
            folds: in which the clips are tested.
            where: whose clips these are, for errors.

        Raises:
            InputError: too few clips for the folds, or nothing that can be learned.
        """
        count, clips = int(self.groups.max()) + 1, len(self.groups)
        if count < 2 * folds:
            what = "clips" if count == clips else f"groups of {clips} clips"
            raise InputError(f"{where}: {count} {what}; `folds` {folds} needs at least {2 * folds}")
        if not self.labels:
            why = self.told_left_out() or ["no targets were given"]
            if self.columns:
                why.append(f"name columns in `targets`, as column:NAME: {', '.join(self.columns)}")
            raise InputError(f"{where}: nothing can be learned: {'; '.join(why)}")

    def told_left_out(self) -> list[str]:
        """A line for each reason, with all targets that it is of."""
        why: dict[str, list[str]] = {}
        for target, reason in self.left_out.items():
            why.setdefault(reason, []).append(target)
        return [f"{', '.join(targets)}: {reason}" for reason, targets in why.items()]

    def told_notes(self) -> list[str]:
        """What is odd about clips, a line for each note."""
        whose: dict[str, list[str]] = {}
        for clip in self.about:
            for note in clip["notes"]:
                whose.setdefault(note, []).append(clip["clip"])
        return [
            f"{clips[0]}{f' and {len(clips) - 1} more' if clips[1:] else ''}: note: {note}"
            for note, clips in whose.items()
        ]


def numbered(names: Sequence[str], hashes: Sequence[str], groups: Sequence[Hashable]) -> np.ndarray:
    """The number of each clip's group, from 0, in the order in which they come, ``(clips,)``.

    Args:
        names, hashes, groups: of each clip, and of its content.

    Raises:
        InputError: a clip that is in two groups, perhaps under two names.
    """
    refuse_leaks(names, hashes, groups, lambda _one, _other: "in two folds")
    number = {group: k for k, group in enumerate(dict.fromkeys(groups))}
    return np.array([number[group] for group in groups])
