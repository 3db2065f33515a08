"""Where a readout looks: our own CNN under the same readouts, and the pooled control."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, cast

from vidphys.experiments.core.cell import Cell, Table
from vidphys.experiments.pixels.pixel_cell import TWINS, PixelCell
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.perception.base import LABELS, REDRAWS, Grounding
from vidphys.perception.catalogue import RUNGS
from vidphys.perception.frozen import SETTINGS
from vidphys.perception.own_cnn import NAME, fit_own_cnn

_SEEN = NAME, "rgb", "cnn", "none", False
OWN_CNN = Grounding(*_SEEN, fit_own_cnn, LABELS, REDRAWS, share=SETTINGS.share)
FROZEN = ("hiera", "i3d")  # rungs of the ladder that are read with the pooled control too


def pooled(grounding: Grounding) -> Grounding:
    """The rung with the mean over all cells in place of attention, at the same budget."""
    fit = partial(cast(Any, grounding.fit), pooled=True)
    return replace(grounding, name=f"{grounding.name}-pooled", fit=fit)


def _cells(*groundings: Grounding) -> dict[str, Cell]:
    each = [g for spatial in groundings for g in (spatial, pooled(spatial))]
    return {g.name: PixelCell(g, TWINS) for g in each}


OWN_CNN_READOUT = Table.told(
    "own-cnn-readout",
    cells=_cells(OWN_CNN),
    settings={"scene": pixel_scene().settings, "share": SETTINGS.share},
)
POOLED_CONTROL = Table.told(
    "pooled-control",
    cells=_cells(*(RUNGS[name] for name in FROZEN)),
    settings={"scene": pixel_scene().settings, "share": SETTINGS.share},
)
