"""Seven kinds of dynamics on the same pictures (the study, figure f28)."""

from __future__ import annotations

from dynamics import HEADS, to_config
from vidphys.experiments.core.cell import Table
from vidphys.experiments.pixels.pixel_cell import PixelCell
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.perception.catalogue import RUNGS

ON_TRACKS = (
    "unstructured",
    "gns",
    "factored-gns",
    "symplectic",
    "factored-learned-kinetic",
    "factored",
)
OWN_LATENT = ("factored",)  # the head through which the latent is trained

PIXEL_HEADS = Table.told(
    "pixel-heads",
    cells={
        "renderer": PixelCell(RUNGS["renderer"], ON_TRACKS),
        "jepa": PixelCell(RUNGS["jepa"], OWN_LATENT),
    },
    settings={
        "scene": pixel_scene().settings,
        "heads": {name: to_config(HEADS[name]) for name in ON_TRACKS},
    },
)
