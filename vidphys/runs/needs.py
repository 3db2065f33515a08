"""What one unit of work needs of a machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Needs:
    """What one unit of work needs of a machine.

    Args:
        cores: that it keeps busy.
        memory: bytes that it takes at most; 0 where nothing is known.
        gpu: of a card, the share; several units share one where that is below 1.
    """

    cores: float = 1.0
    memory: int = 0
    gpu: float = 0.0
