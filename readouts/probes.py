"""What a feature map says of positions and momenta, by one readout for all encoders.

The probe is the position readout with a second output. It sees one feature frame; whether that
frame says anything of motion is the question. Where an encoder sees each frame alone, the frames of
a window may be put side by side instead, and then the readout itself brings the temporal channel.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from readouts.attention import AttentionReadout


class StateProbe(AttentionReadout):
    """Positions and momenta from one feature frame.

    A body's momentum is read by a small network from what its position's query attends to.

    Args:
        channels: of the feature map.
        bodies: number of queries.
        width: of queries, keys and values.
        heads: of the attention; must divide ``width``.
        offset: largest offset of a position, normalised image units.
    """

    def __init__(
        self,
        channels: int,
        bodies: int,
        width: int = 128,
        heads: int = 4,
        offset: float = 0.1,
    ) -> None:
        super().__init__(channels, bodies, width, heads, offset)
        self.move = nn.Sequential(nn.Linear(width, width // 2), nn.GELU(), nn.Linear(width // 2, 2))

    def read_state(
        self,
        values: Float[Tensor, "f c h w"],
        centres: Float[Tensor, "h w 2"],
        kept: Float[Tensor, "f n width"] | None = None,
    ) -> tuple[Float[Tensor, "f n 2"], Float[Tensor, "f n 2"]]:
        """Positions in normalised image units, momenta in the unit that they were trained in.

        Args:
            values: features of frames.
            centres: of the cells, normalised image units.
            kept: factors of the attended features that momentum is read from, for dropout in
                training; all one where not given.
        """
        position, attended = self.look(values, centres)
        return position, self.move(attended if kept is None else attended * kept)


def side_by_side(values: Float[Tensor, "b t c h w"]) -> Float[Tensor, "b tc h w"]:
    """The frames of a window as channels of one feature frame, for a readout over a window."""
    return torch.flatten(values, 1, 2)
