"""The tracked RGB rung: known colours, occlusion, and nothing learned."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from binders import Tracks
from binders.palette import PaletteSettings, track_by_palette
from renderers import RgbWorld
from renderers.splats import disk_coverage
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.perception.base import FitTask, Grounding, Perception

CHUNK = 32  # clips at once


@dataclass(frozen=True)
class PaletteTracking:
    """Follows each body by its colour."""

    settings: PaletteSettings = PaletteSettings()

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame.

        Raises:
            InputError: the clips are of another world.
        """
        world = clips.world
        if not isinstance(world, RgbWorld):
            raise InputError(
                f"rgb-tracked: follows coloured disks, got clips of {type(world).__name__}; "
                "render them in the rgb world"
            )
        bodies, camera = clips.states.q.shape[2], world.camera
        parts = [
            track_by_palette(
                clips.images(slice(at, at + CHUNK)),
                clips.times.float(),
                world.palette[:bodies],
                lambda squared: disk_coverage(squared, world.radius, world.softness),
                camera.xs(),
                camera.ys(),
                self.settings,
            )
            for at in range(0, len(clips), CHUNK)
        ]
        positions = torch.cat([part.positions for part in parts])
        confidence = torch.cat([part.confidence for part in parts])
        return Tracks(positions, confidence, clips.times.float())


def fit_palette(task: FitTask, settings: PaletteSettings = PaletteTracking.settings) -> Perception:
    """Nothing to fit: the palette is known."""
    return PaletteTracking(settings)


PALETTE_GROUNDING = Grounding("rgb-tracked", "rgb", "none", "palette", False, fit_palette)
