"""What a readout attends to: how much each cell of the features counts for each body."""

from __future__ import annotations

import torch
from einops import rearrange
from jaxtyping import Float, Int
from torch import Tensor

from encoders.features import FeatureMap
from readouts.attention import AttentionReadout
from readouts.base import Readout
from readouts.local import RefinedReadout, blocks

MOST = 400  # frames of a clip that are drawn with what is attended to


@torch.no_grad()
def attention_of(
    readout: Readout, features: FeatureMap, frames: Int[Tensor, " t"]
) -> Float[Tensor, "t n h w"] | None:
    """How much each cell counts for the place of each body, in some frames of a clip.

    Args:
        readout: one that attends; for any other there is nothing to tell.
        features: of one clip.
        frames: numbers of the clip's frames; see :func:`drawn_frames`.

    Returns:
        Shares that sum to one over the cells, which are the blocks of cells that a refined readout
        looks at first.
    """
    coarse = readout.coarse if isinstance(readout, RefinedReadout) else readout
    if not isinstance(coarse, AttentionReadout):
        return None
    block = readout.block if isinstance(readout, RefinedReadout) else 1
    seen, which = torch.unique(frames // coarse.frames, return_inverse=True)
    values = features.values.flatten(0, 1).cpu()[seen]
    values, centres = blocks(values, features.cell_centres().cpu(), block)
    height, width = values.shape[-2:]
    tokens = rearrange(values, "f c h w -> f c (h w)").to(coarse.query)
    cells = rearrange(centres, "h w d -> (h w) d").to(tokens)
    mixed = torch.einsum("ng,fgnm->fnm", coarse.mix.softmax(-1), coarse.attend(tokens, cells))
    shape = {"k": coarse.frames, "h": height, "w": width}
    each = rearrange(mixed.cpu(), "f (k n) (h w) -> f k n h w", **shape)
    return each[which, frames % coarse.frames]


def drawn_frames(count: int) -> Int[Tensor, " t"]:
    """Numbers of the frames of a clip that are drawn: all, or :data:`MOST` of them evenly."""
    return torch.arange(0, count, -(-count // MOST))
