"""From the project's frames to what a pretrained image network was trained on."""

from __future__ import annotations

import colorsys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from encoders.grid import Bordered, Size

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


def network_size(
    height: int | float, width: int | float, resolution: int, multiple: int
) -> tuple[int, int]:
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
        # in order: on some processors a picture's sums depend on how its pixels lie in memory
        frames = resize(to_rgb(clips.flatten(0, 1).contiguous()), size, self.mode)
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

Fit = Literal["squash", "crop", "pad", "keep"]


def require_square(name: str, fit: Fit) -> None:
    """Refuse pictures in their own shape, for a network that takes squares."""
    if fit == "keep":
        raise ValueError(f"{name}: takes squares only, which fit squash, crop and pad give it")


@dataclass(frozen=True)
class Fitting:
    """How pictures of any shape become what a network takes.

    ``squash`` resizes the whole picture to the square, whatever its shape. ``crop`` does what the
    libraries' own processors do: it resizes the picture in its shape and takes the square in the
    middle; what lies outside is not seen. ``pad`` resizes the whole picture in its shape and fills
    up to the square with the mean colour; cells on the filling are left out of the maps. ``keep``
    resizes the whole picture in its shape, for a network that takes any.

    Args:
        fit: one of these.
        side: network pixels of the square's side; of the longer side for ``keep``.
        multiple: network pixels that sides are rounded to: those of a cell, of the layer with the
            largest.
        before: for ``crop``, network pixels of the shorter side before the cut, or (height, width)
            where a processor has both; the square's side where not given.

    Example:
        >>> wide = (180, 320)
        >>> Fitting("crop", 224).whole(wide), Fitting("pad", 224, 16).whole(wide)
        ((224, 398), (128, 224))
        >>> Fitting("crop", 224).framed(wide).border  # pixels of the picture
        (0.0, 69.949748743718...)
    """

    fit: Fit
    side: int
    multiple: int = 1
    before: int | float | Size | None = None

    def __post_init__(self) -> None:
        if self.fit not in ("squash", "crop", "pad", "keep"):
            raise ValueError(
                f"encoder: no fit {self.fit!r}; there are squash, crop and pad, and keep for "
                "networks that take pictures of any shape"
            )
        network_size(1, 1, self.side, self.multiple)

    def __str__(self) -> str:
        rounded = f"sides to multiples of {self.multiple}"
        if self.fit == "crop":
            return f"shorter side to {self.before or self.side}, the square in the middle"
        if self.fit == "pad":
            return f"longer side to resolution, {rounded}, filled up to the square"
        return "the image to the square" if self.fit == "squash" else rounded

    def padded(self, shapes: Iterable[Sequence[int]]) -> Fitting:
        """The same, rounded to the largest cells of maps ``(…, h, w)`` of the square.

        Raises:
            ValueError: they do not divide the square.
        """
        cells = {count for shape in shapes for count in shape[-2:]}
        if cells == {1}:
            return self  # nothing to leave out
        return replace(self, multiple=self.side // min(cells))

    def whole(self, size: Size) -> tuple[int, int]:
        """Network pixels of the whole picture, of one of ``size``."""
        height, width = size
        if self.fit == "squash":
            return self.side, self.side
        if self.fit != "crop":
            return network_size(height, width, self.side, self.multiple)
        if isinstance(self.before, tuple):
            sides = self.before
        else:
            scale = (self.before or self.side) / min(size)
            sides = height * scale, width * scale
        # the nearest whole numbers of which as much can be cut on the one hand as on the other
        rows, columns = (self.side + 2 * max(0, round((x - self.side) / 2)) for x in sides)
        return rows, columns

    def framed(self, size: Size) -> Size:
        """A picture's size, with the border of it that features leave out."""
        if self.fit != "crop":
            return size
        cut = tuple(
            (network - self.side) / 2 * pixels / network
            for network, pixels in zip(self.whole(size), size, strict=True)
        )
        return Bordered(size, (cut[0], cut[1])) if any(cut) else size

    def pixels(
        self, clips: Float[Tensor, "n f c H W"], look: Look, dtype: torch.dtype
    ) -> Float[Tensor, "n f 3 h w"]:
        """What the network takes of clips."""
        whole = self.whole((clips.shape[-2], clips.shape[-1]))
        found = look.clips(clips, whole, dtype)
        if self.fit == "crop":
            top, left = ((side - self.side) // 2 for side in whole)
            return found[..., top : top + self.side, left : left + self.side].contiguous()
        if self.fit != "pad":
            return found
        above, left = self._filled(whole)
        below, right = self.side - whole[0] - above, self.side - whole[1] - left
        return functional.pad(found, (left, right, above, below))  # zero is the mean colour

    def kept(self, maps: Float[Tensor, "*n h w"], size: Size) -> Float[Tensor, "*n y x"]:
        """The cells of a map that lie on a picture of ``size``."""
        if self.fit != "pad":
            return maps
        whole = self.whole(size)
        sides = zip(self._filled(whole), whole, maps.shape[-2:], strict=True)
        rows, columns = (
            slice(first * cells // self.side, -(-(first + pixels) * cells // self.side))
            for first, pixels, cells in sides
        )
        return maps[..., rows, columns]

    def _filled(self, whole: tuple[int, int]) -> tuple[int, int]:
        """Network pixels of filling above and left: whole cells."""
        above, left = ((self.side - side) // self.multiple // 2 * self.multiple for side in whole)
        return above, left


def imagenet_clips(
    clips: Float[Tensor, "n f c H W"], size: tuple[int, int], dtype: torch.dtype
) -> Float[Tensor, "n f 3 h w"]:
    """Clips as RGB of the network's size, with ImageNet's mean and deviation, cast last."""
    return IMAGENET.clips(clips, size, dtype)
