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
    """Frames to maps of the network's intermediate layers, which ``layers`` names in their order.

    Args:
        network: of timm, with ``forward_intermediates``.
        settings: with ``resolution``; see :class:`FrozenEncoder`.
        multiple: network pixels that sides are rounded to.
        norm: whether the network's final norm follows the last of them.
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
        norm: bool = False,
        look: Look = IMAGENET,
        square: bool = False,
        **identity: Any,
    ) -> None:
        identity = {"resolution": getattr(settings, "resolution", None), **identity}
        network_size(1, 1, identity["resolution"], multiple)
        self.multiple, self.norm, self.look, self.square = multiple, norm, look, square
        super().__init__(network, settings, Windowing(), **identity)

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        height, width = (1, 1) if self.square else clips.shape[-2:]
        size = network_size(height, width, self.identity.resolution, self.multiple)
        pixels = self.look.clips(clips, size, self.dtype)
        found = self.fast_maps(pixels.flatten(0, 1), layers)
        return [maps.unflatten(0, clips.shape[:2]) for maps in found]

    def maps(self, pixels: Tensor, layers: tuple[str, ...]) -> list[Tensor]:
        """``(f, 3, h, w)`` to ``(f, k, h, w)`` of each layer."""
        forward = cast(Callable[..., list[Tensor]], self.network.forward_intermediates)
        maps = forward(
            pixels,
            indices=[self.layers.index(layer) for layer in layers],
            norm=False,  # which would norm all of them
            intermediates_only=True,
            stop_early=True,
            output_fmt="NCHW",
        )
        if self.norm and layers[-1] == self.layers[-1]:
            maps[-1] = _normed(cast(nn.Module, self.network.norm), maps[-1])
        return maps


def _normed(norm: nn.Module, maps: Tensor) -> Tensor:
    """Maps through a norm, which a transformer has of tokens."""
    if type(norm).__name__.endswith("2d"):
        return norm(maps)
    return norm(maps.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
