"""A unit of a plan: what one worker does in one go, as every engine takes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from vidphys.runs.folder import RunFolder
from vidphys.runs.needs import Needs


@dataclass(frozen=True)
class WorkUnit:
    """What one worker does in one go.

    Args:
        parts: names under which its work is kept, and of each the cell that it is of, as the run
            folder names what was skipped. The first is the name of its log.
        subject: of whom it is said where what it needs is not on this machine.
        arguments: of the function that does it, after the run folder.
        needs: of a machine.
    """

    parts: Mapping[str, str]
    subject: str
    arguments: tuple[Any, ...]
    needs: Needs = field(default_factory=Needs)

    @property
    def name(self) -> str:
        return next(iter(self.parts))

    def is_done(self, run: RunFolder) -> bool:
        return all(map(run.is_done, self.parts))
