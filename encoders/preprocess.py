"""From the project's frames to what a pretrained image network was trained on."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


def to_rgb(frames: Float[Tensor, "f c H W"]) -> Float[Tensor, "f 3 H W"]:
    """Any number of channels to RGB.

    Three channels are RGB already; one is grey; any other number is a world with one channel a
    body, drawn in hues spread evenly over the colour circle and summed (for three this would be
    the identity), clipped to 1.
    """
    channels = frames.shape[1]
    if channels == 3:
        return frames
    if channels == 1:
        return frames.expand(-1, 3, -1, -1)
    hues = [colorsys.hsv_to_rgb(k / channels, 1.0, 1.0) for k in range(channels)]
    palette = frames.new_tensor(hues)
    return torch.einsum("fkhw,kc->fchw", frames, palette).clamp_max(1.0)


def network_size(height: int, width: int, resolution: int, multiple: int) -> tuple[int, int]:
    """Size (height, width) that frames are resized to.

    The longer side becomes ``resolution``, the shorter side keeps the aspect ratio up to the
    rounding to the nearest ``multiple``, at least one.

    Raises:
        ValueError: ``resolution`` is not a positive multiple of ``multiple``.
    """
    if resolution < multiple or resolution % multiple:
        raise ValueError(
            f"encoder: resolution {resolution} must be a multiple of {multiple}; the nearest is "
            f"{max(multiple, round(resolution / multiple) * multiple)}"
        )
    scale = resolution / max(height, width)
    sides = [max(multiple, round(side * scale / multiple) * multiple) for side in (height, width)]
    return sides[0], sides[1]


def resize(
    frames: Float[Tensor, "f c H W"], size: tuple[int, int], mode: str = "bilinear"
) -> Float[Tensor, "f c h w"]:
    """Antialiased where it shrinks; the image's edges stay its edges, values stay in [0, 1]."""
    if frames.shape[-2:] == size:
        return frames
    found = functional.interpolate(frames, size, mode=mode, align_corners=False, antialias=True)
    return found if mode == "bilinear" else found.clamp(0, 1)


@dataclass(frozen=True)
class Look:
    """How a network was shown its images, but for their size.

    Args:
        mean, std: of red, green and blue, of values in [0, 1].
        mode: of resizing, ``bilinear`` or ``bicubic``.
    """

    mean: tuple[float, ...] = IMAGENET_MEAN
    std: tuple[float, ...] = IMAGENET_STD
    mode: str = "bilinear"

    def __str__(self) -> str:
        if self == Look():
            return "bilinear, imagenet"
        return f"{self.mode}, mean {self.mean}, std {self.std}"

    def clips(
        self, clips: Float[Tensor, "n f c H W"], size: tuple[int, int], dtype: torch.dtype
    ) -> Float[Tensor, "n f 3 h w"]:
        """Clips as RGB of the network's size, normalised, cast last."""
        frames = resize(to_rgb(clips.flatten(0, 1)), size, self.mode)
        mean, std = (frames.new_tensor(x)[:, None, None] for x in (self.mean, self.std))
        return ((frames - mean) / std).to(dtype).unflatten(0, clips.shape[:2])


IMAGENET = Look()
# by the name that the table of known weights has for them
LOOKS = {
    "imagenet": IMAGENET,
    "half": Look((0.5,) * 3, (0.5,) * 3),
    "timesformer": Look((0.45,) * 3, (0.225,) * 3),
    "unit": Look((0.0,) * 3, (1.0,) * 3),
}


def imagenet_clips(
    clips: Float[Tensor, "n f c H W"], size: tuple[int, int], dtype: torch.dtype
) -> Float[Tensor, "n f 3 h w"]:
    """Clips as RGB of the network's size, with ImageNet's mean and deviation, cast last."""
    return IMAGENET.clips(clips, size, dtype)
