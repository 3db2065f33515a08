"""The tracked RGB rung: bodies by their colours, occlusion, and nothing learned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from binders import Tracks
from binders.palette import PaletteSettings, track_by_palette
from renderers import RgbWorld
from renderers.splats import disk_coverage
from vidphys.data.clips import Clips
from vidphys.errors import InputError
from vidphys.perception.base import BLOBS, COLOURS, UNTOLD, FitTask, Grounding, Perception
from vidphys.perception.blobs import Colours, measured_colours

CHUNK = 32  # clips at once


@dataclass(frozen=True)
class PaletteTracking:
    """Follows each body by its colour.

    Args:
        settings: of the tracker.
        seen: colours and looks that were measured; those of the clips' world where not given.
        device: where it looks.
    """

    settings: PaletteSettings = PaletteSettings()
    seen: Colours | None = None
    device: str = "cpu"

    def tracks(self, clips: Clips) -> Tracks:
        """Positions of every body in every frame.

        Raises:
            InputError: the clips are of another world.
        """
        world = _rgb_world(clips)
        bodies, camera = clips.states.q.shape[2], world.camera

        def drawn(squared: Tensor) -> Tensor:
            return disk_coverage(squared, world.radius, world.softness)

        coverage: Callable[[Tensor], Tensor] = drawn
        palette = world.palette[:bodies]
        if self.seen is not None:
            coverage, palette = self.seen.coverage, self.seen.palette
        parts = [
            track_by_palette(
                clips.images(slice(at, at + CHUNK), self.device),
                clips.times.float(),
                palette,
                coverage,
                camera.xs(device=self.device),
                camera.ys(device=self.device),
                self.settings,
            )
            for at in range(0, len(clips), CHUNK)
        ]
        positions = torch.cat([part.positions.cpu() for part in parts])
        confidence = torch.cat([part.confidence.cpu() for part in parts])
        return Tracks(positions, confidence, clips.times.float())


def fit_palette(
    task: FitTask, settings: PaletteSettings = PaletteTracking.settings, blobs: bool = False
) -> Perception:
    """Nothing to fit where the palette is known; else colours and looks are measured.

    Raises:
        InputError: the clips are of another world, or too few bodies stand alone.
    """
    _rgb_world(task.clips)
    if not blobs:
        return PaletteTracking(settings, device=task.device)
    seen = measured_colours(task.clips)
    return PaletteTracking(replace(settings, in_order=False), seen, task.device)


def _rgb_world(clips: Clips) -> RgbWorld:
    if not isinstance(clips.world, RgbWorld):
        raise InputError(
            f"rgb-tracked: follows coloured disks, got clips of {type(clips.world).__name__}; "
            "render them in the rgb world"
        )
    return clips.world


PALETTE_GROUNDING = Grounding(
    "rgb-tracked", "rgb", "none", "palette", False, fit_palette, UNTOLD, COLOURS
)
PALETTE_GROUNDINGS = [
    PALETTE_GROUNDING,
    PALETTE_GROUNDING.varied("blobs", knows=f"{BLOBS} of one colour each", blobs=True),
]
