"""Whether a readout of positions keeps its contract."""

from __future__ import annotations

import copy
import math

import torch
from torch import Tensor, nn

from encoders.features import FeatureMap
from readouts import READOUTS, FrameReadout, MapShape, Recipe
from vidphys.testing.failed import expect, expect_same, expect_spoiled, pickled

BODIES, CHANNELS, GRID, FRAMES = 2, 6, (6, 8), 5
BEYOND = 1.5  # normalised image units from the centre, past which no position is in the picture


def check_readout(readout: str | FrameReadout, bodies: int = BODIES) -> None:
    """Check a readout: everything that a training over a frozen encoder relies on.

    Positions in the picture and confidence in [0, 1], both of each frame by itself; the same
    twice and when pickled; no finite answer to a NaN; gradients that reach the weights.

    Args:
        readout: a registered kind, a ``package.module:attribute`` of one, or a readout for maps of
            6 channels on 6 by 8 cells.
        bodies: that it reads.

    Raises:
        CheckFailed: what was expected, and what came.
    """
    torch.manual_seed(0)
    if isinstance(readout, str):
        made_for = MapShape(CHANNELS, GRID, bodies)
        readout = Recipe(readout, made_for, READOUTS[readout].sizes).build()
    made, name = copy.deepcopy(readout).eval(), type(readout).__name__
    rng = torch.Generator().manual_seed(0)
    values = torch.randn(FRAMES, CHANNELS, *GRID, generator=rng)
    centres = FeatureMap(values[None], (4.0, 4.0), torch.arange(FRAMES) / 25).cell_centres()
    made.fit_scale(values)

    def read(frames: Tensor, by: FrameReadout = made) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            return by.read(frames, centres)

    positions, sure = read(values)
    for what, found, shape in (
        ("positions", positions, (FRAMES, bodies, 2)),
        ("confidence", sure, (FRAMES, bodies)),
    ):
        expect(tuple(found.shape) == shape, f"{name}: {what}", shape, tuple(found.shape))
        expect(bool(torch.isfinite(found).all()), f"{name}: {what}", "finite", "others")
    far = float(positions.abs().max())
    expect(far <= BEYOND, f"{name}: positions", "normalised image units within the picture", far)
    inside = bool(((sure >= 0) & (sure <= 1)).all())
    expect(inside, f"{name}: confidence", "within [0, 1]", sure.aminmax())
    expect(torch.equal(positions, read(values)[0]), name, "the same twice", "another answer")
    copied = read(values, pickled(made, name))[0]
    expect(torch.equal(positions, copied), name, "the same when pickled", "another answer")
    for frame in range(FRAMES):
        alone = read(values[frame : frame + 1])[0][0]
        expect_same(alone, positions[frame], name, "a frame alone as in company", 1e-5)
    spoiled = values.clone()
    spoiled[0, 0] = math.nan
    expect_spoiled(lambda: read(spoiled)[0][0], f"{name} of a NaN map")
    _check_gradient(made, name, values, centres)


def _check_gradient(made: nn.Module, name: str, values: Tensor, centres: Tensor) -> None:
    made.zero_grad()
    positions, sure = made.train().read(values, centres)  # type: ignore[operator]
    (positions.square().sum() + sure.sum()).backward()
    slopes = [p.grad for p in made.parameters() if p.requires_grad]
    reached = any(slope is not None and bool(slope.abs().sum() > 0) for slope in slopes)
    expect(not slopes or reached, name, "a gradient that reaches its weights", "none")
