"""What the video transformers share: the layer that is read, and tokens as maps."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from encoders.frozen.windows import Windowing


def numbered(depth: int) -> tuple[str, ...]:
    """Names of the layers of a network that counts them from 1."""
    return tuple(str(number + 1) for number in range(depth))


def chosen_layer(name: str, layer: int | str | None, layers: tuple[str, ...]) -> str:
    """The layer that is read: ``layer``, or the last of ``layers``.

    Raises:
        ValueError: the network has no such layer.
    """
    if layer is None:
        return layers[-1]
    if str(layer) not in layers:
        plain = layers == numbered(len(layers))
        known = f"1 to {layers[-1]}" if plain else ", ".join(layers)
        raise ValueError(f"{name}: no layer {layer!r}; it has {known}")
    return str(layer)


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
