"""Where a readout looks: our own CNN under the same readouts, and the pooled control."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, cast

from vidphys.experiments.core.cell import Cell, Table
from vidphys.experiments.pixels.pixel_cell import TWINS, PixelCell
from vidphys.experiments.pixels.seen import pixel_scene
from vidphys.perception.base import Grounding
from vidphys.perception.catalogue import RUNGS
from vidphys.perception.frozen import SHARE
from vidphys.perception.own_cnn import NAME, fit_own_cnn

OWN_CNN = Grounding(NAME, "rgb", "cnn", "none", False, fit_own_cnn, share=SHARE)
FROZEN = ("hiera", "i3d")  # rungs of the ladder that are read with the pooled control too


def pooled(grounding: Grounding) -> Grounding:
    """The rung with the mean over all cells in place of attention, at the same budget."""
    fit = partial(cast(Any, grounding.fit), pooled=True)
    return replace(grounding, name=f"{grounding.name}-pooled", fit=fit)


def _cells(*groundings: Grounding) -> dict[str, Cell]:
    each = [g for spatial in groundings for g in (spatial, pooled(spatial))]
    return {g.name: PixelCell(g, TWINS) for g in each}


OWN_CNN_READOUT = Table(
    name="own-cnn-readout",
    title="Our own CNN under the same readouts",
    about=(
        "A CNN is trained on true positions and frozen; fresh readouts are trained over its "
        "features as over a public encoder's: spatial attention, and the mean over all cells."
    ),
    ids="N74",
    cells=_cells(OWN_CNN),
    settings={"scene": pixel_scene().settings, "share": SHARE},
    pixels=True,
)
POOLED_CONTROL = Table(
    name="pooled-control",
    title="Frozen encoders read by their mean over all cells",
    about=(
        "The same frozen features and budget, once with spatial attention and once pooled. "
        "Pooled features do not say where bodies are, so nothing downstream can be right."
    ),
    ids="N75",
    cells=_cells(*(RUNGS[name] for name in FROZEN)),
    settings={"scene": pixel_scene().settings, "share": SHARE},
    pixels=True,
)
