"""From the project's frames to what a pretrained image network was trained on."""

from __future__ import annotations

import colorsys

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


def resize(frames: Float[Tensor, "f c H W"], size: tuple[int, int]) -> Float[Tensor, "f c h w"]:
    """Bilinear, antialiased where it shrinks; the image's edges stay its edges."""
    if frames.shape[-2:] == size:
        return frames
    return functional.interpolate(
        frames, size, mode="bilinear", align_corners=False, antialias=True
    )


def normalise(frames: Float[Tensor, "f 3 H W"]) -> Float[Tensor, "f 3 H W"]:
    """ImageNet's mean and standard deviation, from values in [0, 1]."""
    mean = frames.new_tensor(IMAGENET_MEAN)[:, None, None]
    std = frames.new_tensor(IMAGENET_STD)[:, None, None]
    return (frames - mean) / std


def imagenet_clips(
    clips: Float[Tensor, "n f c H W"], size: tuple[int, int], dtype: torch.dtype
) -> Float[Tensor, "n f 3 h w"]:
    """Clips as RGB of the network's size, with ImageNet's mean and deviation, cast last."""
    flat = normalise(resize(to_rgb(clips.flatten(0, 1)), size))
    return flat.to(dtype).unflatten(0, clips.shape[:2])
