"""Image networks of timm, frame by frame: each frame is seen alone, at its own time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.windows import Windowing
from encoders.preprocess import IMAGENET, Look, network_size


class TimmMaps(FrozenEncoder):
    """Frames to maps of one of the network's intermediate layers.

    Args:
        network: of timm, with ``forward_intermediates``.
        settings: with ``resolution``; see :class:`FrozenEncoder`.
        multiple: network pixels that sides are rounded to.
        index: of the layer among the network's intermediates.
        norm: whether the network's final norm follows it.
        look: how the network was shown its images.
        square: whether the whole image is resized to a square, as a network of one size needs.
        identity: see :class:`FrozenEncoder`.

    Raises:
        ValueError: a resolution that is no multiple.
    """

    def __init__(
        self,
        network: nn.Module,
        settings: Any,
        multiple: int,
        index: int,
        norm: bool = False,
        look: Look = IMAGENET,
        square: bool = False,
        **identity: Any,
    ) -> None:
        identity = {"resolution": getattr(settings, "resolution", None), **identity}
        network_size(1, 1, identity["resolution"], multiple)
        self.multiple, self.index, self.norm = multiple, index, norm
        self.look, self.square = look, square
        super().__init__(network, settings, Windowing(), **identity)

    def encode(self, clips: Float[Tensor, "n f c H W"]) -> Float[Tensor, "n t k h w"]:
        height, width = (1, 1) if self.square else clips.shape[-2:]
        size = network_size(height, width, self.identity.resolution, self.multiple)
        pixels = self.look.clips(clips, size, self.dtype)
        return self.fast_maps(pixels.flatten(0, 1)).unflatten(0, clips.shape[:2])

    def maps(self, pixels: Tensor) -> Tensor:
        """``(f, 3, h, w)`` to ``(f, k, h, w)``."""
        forward = cast(Callable[..., list[Tensor]], self.network.forward_intermediates)
        (maps,) = forward(
            pixels,
            indices=[self.index],
            norm=self.norm,
            intermediates_only=True,
            stop_early=True,
            output_fmt="NCHW",
        )
        return maps
