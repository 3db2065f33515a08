"""Every grounding of the ladder by name; a new one is one file and one line here."""

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from vidphys.perception.anonymous import ANONYMOUS_GROUNDINGS
from vidphys.perception.base import Grounding
from vidphys.perception.channel_groundings import CHANNEL_GROUNDINGS
from vidphys.perception.composed import COMPOSED_GROUNDINGS
from vidphys.perception.frozen import FROZEN_GROUNDINGS
from vidphys.perception.palette import PALETTE_GROUNDING
from vidphys.perception.slots import SLOT_GROUNDINGS
from vidphys.shooting.initial_state import ShootingSettings
from vidphys.training.tracks import TrackSettings

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

__all__ = ["GROUNDINGS", "Grounding", "rung_settings"]


def rung_settings(names: Iterable[str]) -> dict[str, Any]:
    """For ``run.json``: the settings of each rung that is named, and of what all rungs share."""
    shared = {"start": asdict(ShootingSettings()), "training": asdict(TrackSettings())}
    found = {name: GROUNDINGS[name].settings for name in sorted(set(names)) if name in GROUNDINGS}
    return {"shared": shared, **found}
