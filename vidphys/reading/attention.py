"""What a readout attends to: how much each cell of the features counts for each body."""

from __future__ import annotations

import torch
from einops import rearrange
from jaxtyping import Float
from torch import Tensor

from encoders.features import FeatureMap
from readouts.attention import AttentionReadout
from readouts.base import Readout
from readouts.local import RefinedReadout, blocks


@torch.no_grad()
def attention_of(
    readout: Readout, features: FeatureMap, frames: int
) -> Float[Tensor, "t n h w"] | None:
    """How much each cell counts for the place of each body, in each frame of a clip.

    Args:
        readout: one that attends; for any other there is nothing to tell.
        features: of one clip.
        frames: of the clip.

    Returns:
        Shares that sum to one over the cells, which are the blocks of cells that a refined readout
        looks at first; the last feature frame stands for those that end beyond the clip.
    """
    coarse = readout.coarse if isinstance(readout, RefinedReadout) else readout
    if not isinstance(coarse, AttentionReadout):
        return None
    block = readout.block if isinstance(readout, RefinedReadout) else 1
    values, centres = features.values.flatten(0, 1).cpu(), features.cell_centres().cpu()
    values, centres = blocks(values, centres, block)
    height, width = values.shape[-2:]
    tokens = rearrange(values, "f c h w -> f c (h w)").to(coarse.query.dtype)
    cells = rearrange(centres, "h w d -> (h w) d").to(tokens.dtype)
    mixed = torch.einsum("ng,fgnm->fnm", coarse.mix.softmax(-1), coarse.attend(tokens, cells))
    shape = {"k": coarse.frames, "h": height, "w": width}
    return rearrange(mixed, "f (k n) (h w) -> (f k) n h w", **shape)[:frames]
