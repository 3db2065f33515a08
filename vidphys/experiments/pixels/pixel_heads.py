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

PIXEL_HEADS = Table(
    name="pixel-heads",
    title="Seven dynamics on the same pictures",
    about=(
        "Positions are found by drawing them with the fixed renderer; only the dynamics differ. "
        "The seventh has a latent of its own: a decode-free predictor without any anchor."
    ),
    ids="N56, f28",
    cells={
        "renderer": PixelCell(RUNGS["renderer"], ON_TRACKS),
        "jepa": PixelCell(RUNGS["jepa"], OWN_LATENT),
    },
    settings={
        "scene": pixel_scene().settings,
        "heads": {name: to_config(HEADS[name]) for name in ON_TRACKS},
    },
    pixels=True,
)
