"""Every rung of the ladder by name; a new one is one file and one line here."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from encoders.frozen import ENCODERS, load_encoder
from registry import Registry, unknown
from vidphys.perception.anonymous import ANONYMOUS_GROUNDINGS
from vidphys.perception.base import NOTHING, STATES, FitTask, Grounding, Perception
from vidphys.perception.channel_groundings import CHANNEL_GROUNDINGS
from vidphys.perception.composed import COMPOSED_GROUNDINGS
from vidphys.perception.frozen import FROZEN_GROUNDINGS, rung_over
from vidphys.perception.palette import PALETTE_GROUNDINGS
from vidphys.perception.slots import SLOT_GROUNDINGS
from vidphys.shooting.initial_state import ShootingSettings
from vidphys.training.tracks import TrackSettings


def _sees_nothing(
    task: FitTask, trajectories: int | None = None, oldest: int | None = None
) -> Perception:
    raise ValueError("oracle: its heads are given true states; there is nothing to perceive")


ORACLE = Grounding("oracle", "none", "none", "none", False, _sees_nothing, STATES, NOTHING)
# the study's sizes: so many trajectories, all from the generator's own starts
ORACLES = [
    ORACLE,
    *(ORACLE.varied(str(count), trajectories=count, oldest=0) for count in (32, 512)),
]
RUNGS: Registry[Grounding] = Registry("rung", "vidphys.rungs")
for rung in (
    *ORACLES,
    *CHANNEL_GROUNDINGS,
    *PALETTE_GROUNDINGS,
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
    return {"shared": shared, **{rung.name: _told(rung) for rung in rungs}}


def _told(rung: Grounding) -> dict[str, Any]:
    about = {"supervision": rung.supervision, "knows": rung.knows, "share": rung.share}
    return {**about, **({"variant_of": rung.of} if rung.of else {}), **rung.settings}
