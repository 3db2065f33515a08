"""Which frames of a recording are looked at, counted as a player of the clip counts them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

NAMED = 4  # frames that are named one by one


@dataclass(frozen=True)
class Used:
    """The frames that a motion is of.

    Args:
        total: frames of the recording; ``None`` where nobody counted them.
        first: number of the motion's first frame among them, from 0.
        part: first of them that may be used and the one after the last, where it is cut.
        why: why others are left out, a few words each.
        left_out: their numbers, where they lie between frames that are used.
    """

    total: int | None
    first: int = 0
    part: tuple[int, int] | None = None
    why: tuple[str, ...] = ()
    left_out: tuple[int, ...] = ()

    def within(self, begin: int, stop: int) -> bool:
        """Whether frames ``begin`` to ``stop`` are less than the part that may be used."""
        return self.part is None or stop - begin < self.part[1] - self.part[0]

    def line(self, begin: int, stop: int, why: Sequence[str]) -> str:
        """One line on the motion's frames ``begin`` to ``stop``, with reasons of its own."""
        of = "" if self.total is None else f" of {self.total}"
        reasons = "; ".join((*self.why, *why))
        text = f"Frames {self.first + begin} to {self.first + stop - 1}{of} are used"
        return f"{text}: {reasons}." if reasons else f"{text}."

    def data(self, begin: int, stop: int) -> dict[str, Any]:
        """The same as JSON; ``stop`` is the frame after the last."""
        return {
            "first": self.first + begin,
            "last": self.first + stop - 1,
            "of": self.total,
            "left_out": list(self.left_out),
        }


def counted(frames: Sequence[int], noun: str) -> str:
    """So many frames of a kind, and the first of them by number."""
    named = ", ".join(map(str, frames[:NAMED])) + (", ..." if len(frames) > NAMED else "")
    return f"{len(frames)} {noun} frame{'s' if len(frames) > 1 else ''} left out ({named})"
