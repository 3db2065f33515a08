"""Every grounding of the ladder by name; a new one is one file and one line here."""

from vidphys.perception.anonymous import ANONYMOUS_GROUNDINGS
from vidphys.perception.base import Grounding
from vidphys.perception.channel_groundings import CHANNEL_GROUNDINGS
from vidphys.perception.composed import COMPOSED_GROUNDINGS
from vidphys.perception.frozen import FROZEN_GROUNDINGS
from vidphys.perception.palette import PALETTE_GROUNDING
from vidphys.perception.slots import SLOT_GROUNDINGS

GROUNDINGS: dict[str, Grounding] = {
    g.name: g
    for g in (
        *CHANNEL_GROUNDINGS,
        PALETTE_GROUNDING,
        *ANONYMOUS_GROUNDINGS,
        *SLOT_GROUNDINGS,
        *FROZEN_GROUNDINGS,
        *COMPOSED_GROUNDINGS,
    )
}

__all__ = ["GROUNDINGS", "Grounding"]
