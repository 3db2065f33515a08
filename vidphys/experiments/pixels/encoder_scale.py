"""Whether a larger frozen encoder reads better: the same rung over several sizes."""

from __future__ import annotations

from vidphys.experiments.core.cell import Table
from vidphys.experiments.pixels.pixel_cell import TWINS, PixelCell
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.perception.base import Grounding
from vidphys.perception.frozen import SETTINGS, rung_over

VIDEO = ("vjepa2-l", "vjepa2-h", "vjepa2-g")  # 300, 600 and 1,000 million parameters
IMAGE = ("dinov2-small", "dinov2-base", "dinov2-large")  # 22, 86 and 300 million


def rung(encoder: str, video: bool) -> Grounding:
    """A frozen rung of the encoder at its own settings."""
    return rung_over(encoder, encoder, video)


ENCODER_SCALE = Table.told(
    "encoder-scale",
    cells={name: PixelCell(rung(name, name in VIDEO), TWINS) for name in (*VIDEO, *IMAGE)},
    settings={"scene": pixel_scene().settings, "share": SETTINGS.share},
)
