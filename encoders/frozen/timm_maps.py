"""Image networks of timm, frame by frame: each frame is seen alone, at its own time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from jaxtyping import Float
from torch import Tensor, nn

from encoders.frozen.base import FrozenEncoder
from encoders.frozen.windows import Windowing
from encoders.preprocess import IMAGENET, Fitting, Look


class TimmMaps(FrozenEncoder):
    """Frames to maps of the network's intermediate layers, which ``layers`` names in their order.

    Args:
        network: of timm, with ``forward_intermediates``.
        settings: see :class:`FrozenEncoder`.
        fitting: how frames become the network's input.
        norm: whether the network's final norm follows the last of them.
        look: how the network was shown its images.
        identity: see :class:`FrozenEncoder`; its resolution is that of the fitting.
    """

    fitting: Fitting

    def __init__(
        self,
        network: nn.Module,
        settings: Any,
        fitting: Fitting,
        norm: bool = False,
        look: Look = IMAGENET,
        **identity: Any,
    ) -> None:
        self.fitting, self.norm, self.look = fitting, norm, look
        super().__init__(network, settings, Windowing(), resolution=fitting.side, **identity)

    def encode(
        self, clips: Float[Tensor, "n f c H W"], layers: tuple[str, ...]
    ) -> list[Float[Tensor, "n t k h w"]]:
        pixels = self.fitting.pixels(clips, self.look, self.dtype)
        found = self.fast_maps(pixels.flatten(0, 1), layers)
        size = clips.shape[-2], clips.shape[-1]
        return [self.fitting.kept(maps, size).unflatten(0, clips.shape[:2]) for maps in found]

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
