"""What the video transformers share: the layer that is read, and tokens as maps."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from encoders.frozen.windows import Windowing


def chosen_layer(name: str, layer: int | None, depth: int) -> int:
    """Number of blocks to run: ``layer``, or all of ``depth``.

    Raises:
        ValueError: the network has no such block.
    """
    if layer is None:
        return depth
    if not isinstance(layer, int) or not 1 <= layer <= depth:
        raise ValueError(f"{name}: no layer {layer!r}; it has 1 to {depth}")
    return layer


def token_maps(
    tokens: Float[Tensor, "n tokens k"], frames: int, height: int, width: int
) -> Float[Tensor, "n {frames} k {height} {width}"]:
    """Tokens in the order time, row, column as maps."""
    return tokens.unflatten(1, (frames, height, width)).permute(0, 1, 4, 2, 3)


def windowing_words(windowing: Windowing, frame_stride: int) -> str:
    """How time is sampled, for an encoder's identity."""
    return (
        f"each {frame_stride}. frame, windows of {windowing.frames} frames, hop {windowing.step}, "
        f"tubelets of {windowing.tubelet}"
    )
