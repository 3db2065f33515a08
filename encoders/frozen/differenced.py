"""An image encoder with frame differencing: what each frame is, and how it changes in time.

The features of a frame are followed by their change: the features of the frame ``reach`` frames
later less those of the frame as many before, over the frames in between. At the ends of a clip the
nearest frame takes the place of one that is not there. A feature frame stays at its frame's own
time, for the difference lies evenly about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

import torch
from jaxtyping import Float
from torch import Tensor

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.windows import Windowing


class Differenced(FrozenEncoder):
    """The features of an image encoder, and as many channels of their change.

    Args:
        plain: sees each frame alone. Its ``batch`` is that of the frames that a pass adds.
        reach: frames to either side that the difference is of.

    Raises:
        ValueError: an encoder that sees several frames together, or a reach below one.
    """

    def __init__(self, plain: FrozenEncoder, reach: int) -> None:
        identity = asdict(plain.identity)
        name = identity["name"]
        if plain.windowing != Windowing():
            raise ValueError(
                f"{name}: sees frames together; `difference` is for encoders of single images"
            )
        if reach < 1:
            raise ValueError(f"{name}: difference {reach}: must be at least 1 frame")
        self.plain, self.reach, self.fitting = plain, reach, plain.fitting
        # windows overlap by the reach, so that each kept frame has its neighbours
        windowing = Windowing(plain.batch + 2 * reach, plain.batch, shortens=True)
        words = f"{identity.pop('preprocessing')}, and the change over {reach} frames to each side"
        del identity["dtype"]
        super().__init__(
            plain.network, plain.settings, windowing, plain.layers, preprocessing=words, **identity
        )
        self.batch = 1

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> Sequence[Float[Tensor, "n t k h w"]]:
        return [with_change(maps, self.reach) for maps in self.plain.encode(clips, layers)]


def with_change(maps: Float[Tensor, "n t k h w"], reach: int) -> Float[Tensor, "n t 2*k h w"]:
    """Maps, and their change a frame between ``reach`` frames before and as many after.

    Example:
        >>> speeds = with_change(torch.arange(5.0).reshape(1, 5, 1, 1, 1) ** 2, 1)
        >>> speeds.flatten().tolist()[1::2]
        [1.0, 2.0, 4.0, 6.0, 7.0]
    """
    frames = torch.arange(maps.shape[1], device=maps.device)
    before, after = (frames - reach).clamp_min(0), (frames + reach).clamp_max(len(frames) - 1)
    apart = (after - before).clamp_min(1).to(maps.dtype)
    change = (maps[:, after] - maps[:, before]) / apart[:, None, None, None]
    return torch.cat([maps, change], 2)
