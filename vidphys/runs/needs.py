"""What one unit of work needs of a machine."""

from __future__ import annotations

from dataclasses import dataclass

from vidphys.runs.cards import cards


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


def card_share(workers: int, address: str | None) -> float:
    """Of a card, what each of so many workers gets: of all cards here, or of each of a cluster.

    Args:
        workers: of this machine, among which its cards are shared; of each card of a cluster.
        address: of that cluster.
    """
    return min(1.0, (1 if address else max(1, len(cards()))) / workers)
