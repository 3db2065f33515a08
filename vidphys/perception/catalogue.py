"""Every rung of the ladder by name; a new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from encoders.frozen import ENCODERS, load_encoder
from registry import Registry, unknown
from vidphys.perception.anonymous import ANONYMOUS_GROUNDINGS
from vidphys.perception.base import FitTask, Grounding, Perception
from vidphys.perception.channel_groundings import CHANNEL_GROUNDINGS
from vidphys.perception.composed import COMPOSED_GROUNDINGS
from vidphys.perception.frozen import FROZEN_GROUNDINGS, rung_over
from vidphys.perception.palette import PALETTE_GROUNDING
from vidphys.perception.slots import SLOT_GROUNDINGS
from vidphys.shooting.initial_state import ShootingSettings
from vidphys.training.tracks import TrackSettings


def _sees_nothing(task: FitTask) -> Perception:
    raise ValueError("oracle: its heads are given true states; there is nothing to perceive")


ORACLE = Grounding("oracle", "none", "none", "none", False, _sees_nothing)
RUNGS: Registry[Grounding] = Registry("rung", "vidphys.rungs")
for rung in (
    ORACLE,
    *CHANNEL_GROUNDINGS,
    PALETTE_GROUNDING,
    *ANONYMOUS_GROUNDINGS,
    *SLOT_GROUNDINGS,
    *FROZEN_GROUNDINGS,
    *COMPOSED_GROUNDINGS,
):
    RUNGS.register(rung.name, rung)


def rung_of(name: str) -> Grounding:
    """The rung of a name, or over the encoder of a name: disks of other colours, and its features.

    Args:
        name: of a rung or an encoder, or ``package.module:attribute`` of either.

    Raises:
        UnknownName: there is neither.
        ValueError: the encoder cannot be made.
    """
    if name in RUNGS:
        return RUNGS[name]
    if name not in ENCODERS and ":" not in name:
        raise unknown(RUNGS.what, name, (*RUNGS, *ENCODERS.foreign()))
    part: Any = ENCODERS[name]
    if isinstance(part, Grounding):
        return part
    return rung_over(name, name, video=load_encoder(name, {}).frames_per_feature > 1)


def rung_settings(rungs: Iterable[Grounding]) -> dict[str, Any]:
    """For ``run.json``: the settings of each rung by name, and of what all rungs share."""
    shared = {"start": asdict(ShootingSettings()), "training": asdict(TrackSettings())}
    return {"shared": shared, **{rung.name: rung.settings for rung in rungs}}
