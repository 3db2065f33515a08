"""A video that is in memory already, through a frozen encoder, in whatever order its axes are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from encoders.features import FeatureMap
from encoders.frozen.catalogue import load_encoder
from encoders.identity import IdentifiedEncoder
from encoders.preprocess import to_rgb

Layout = Literal["thwc", "tchw", "bthwc", "btchw"]
LAYOUTS = ", ".join(get_args(Layout))
COLOURS = (1, 3)
WANTED = "uint8 (t, H, W, 3) or (t, 3, H, W), or floats from 0 to 1, with a batch in front or not"


def encode_video(
    frames: np.ndarray | Tensor | Sequence[Any],
    times: np.ndarray | Tensor | Sequence[float],
    encoder: str | IdentifiedEncoder = "dino-tiny",
    layout: Layout | None = None,
    bodies: bool = False,
    weights: Path | None = None,
    device: str = "cpu",
    **options: Any,
) -> FeatureMap:
    """The features of a video, or of a batch of videos that were taken at the same times.

    Args:
        frames: bytes, or floats from 0 to 1; RGB or grey, row 0 on top.
        times: seconds of each frame, rising.
        encoder: name of a frozen encoder, or one that is loaded.
        layout: which axis is what, in order: b a video, t a frame, h a row, w a column, c a
            channel. Found by the sizes where only one axis can be the channels.
        bodies: a channel is a body, drawn in a hue of its own; needed for other than 1 or 3.
        weights, device, options: see :func:`encoders.frozen.catalogue.load_encoder`.

    Returns:
        Features ``(b, t, c, h, w)``; ``b`` is 1 for a single video.

    Raises:
        ValueError: no such video, axes that are in doubt, or times that are not its own; the
            message says what came and what was expected.

    Example:
        >>> film = np.zeros((4, 48, 64, 3), np.uint8)  # as imageio or OpenCV give it
        >>> found = encode_video(film, [0.0, 0.04, 0.08, 0.12], resolution=64)
        >>> tuple(found.values.shape[:2]), found.grid
        ((1, 4), (12, 16))
    """
    video = _videos(_array(frames, "frames"), layout, bodies)
    seconds = _seconds(times, video.shape[1])
    if isinstance(encoder, str):
        encoder = load_encoder(encoder, options, weights, device)
    elif options:
        raise ValueError(f"encode_video: {', '.join(options)}: a loaded encoder takes no options")
    return encoder(video, seconds)


def _array(value: Any, name: str) -> Tensor:
    if isinstance(value, Tensor):
        return value.detach()
    with np.errstate(all="ignore"):
        try:
            array = np.asarray(value)
        except ValueError as error:
            raise ValueError(f"encode_video: `{name}`: of unequal sizes ({error})") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(
            f"encode_video: `{name}` holds {array.dtype}, not numbers; wants {WANTED}"
            if name == "frames"
            else f"encode_video: `{name}` holds {array.dtype}; give the seconds of each frame"
        )
    return torch.from_numpy(np.array(array, order="C"))


def _videos(frames: Tensor, layout: Layout | None, bodies: bool) -> Tensor:
    """``(b, t, c, H, W)``, bytes or float32."""
    shape = tuple(frames.shape)
    if layout is None:
        layout = _found(shape, bodies)
    elif layout not in get_args(Layout):
        raise ValueError(
            f"encode_video: `layout` {layout!r}; use one of {', '.join(get_args(Layout))}"
        )
    if len(layout) != len(shape):
        raise ValueError(f"encode_video: `frames` {shape} has {len(shape)} axes, not {layout}")
    if not frames.numel():
        raise ValueError(f"encode_video: `frames` {shape} holds nothing; wants {WANTED}")
    if not frames.is_floating_point() and frames.dtype != torch.uint8:
        raise ValueError(
            f"encode_video: `frames` of {_called(frames)}; wants uint8 from 0 to 255, or floats "
            "from 0 to 1"
        )
    frames = frames if len(shape) == 5 else frames[None]
    video = frames.movedim(-1, 2) if layout.endswith("c") else frames
    if video.dtype != torch.uint8:
        video = video.float()
        low, high = map(float, video.aminmax())
        if not (low >= 0 and high <= 1):
            raise ValueError(
                f"encode_video: `frames` from {low:.3g} to {high:.3g}; wants floats from 0 to 1: "
                "divide by 255, or give uint8"
            )
    if video.shape[2] in COLOURS:
        return video
    if not bodies:
        raise ValueError(
            f"encode_video: {video.shape[2]} channels in `frames` {shape} as {layout}; wants 1 or "
            "3: leave an alpha channel away, or say `bodies`=True where each channel is a body"
        )
    floats = video / 255 if video.dtype == torch.uint8 else video
    return to_rgb(floats.flatten(0, 1)).unflatten(0, video.shape[:2])


def _found(shape: tuple[int, ...], bodies: bool) -> Layout:
    """The layout, where the sizes leave no doubt."""
    if len(shape) not in (4, 5):
        raise ValueError(f"encode_video: `frames` {shape} has {len(shape)} axes; wants {WANTED}")
    last, inner = shape[-1] in COLOURS, shape[-3] in COLOURS
    if bodies or last == inner:
        why = "both ends could be channels" if last else "no axis has 1 or 3 channels"
        raise ValueError(
            f"encode_video: `frames` {shape}: {'channels are bodies' if bodies else why}; say "
            f"which axis is what with `layout`, one of {LAYOUTS}"
        )
    batch = "b" if len(shape) == 5 else ""
    return f"{batch}t{'hwc' if last else 'chw'}"  # type: ignore[return-value]


def _seconds(times: Any, count: int) -> Tensor:
    seconds = _array(times, "times").double()
    if seconds.shape != (count,):
        raise ValueError(
            f"encode_video: `times` {tuple(seconds.shape)} for {count} frames; give the seconds of "
            f"each, such as numpy.arange({count}) / 25"
        )
    if not bool(torch.isfinite(seconds).all()) or not bool((seconds.diff() > 0).all()):
        raise ValueError("encode_video: `times` must be finite and rise from frame to frame")
    return seconds


def _called(frames: Tensor) -> str:
    return str(frames.dtype).removeprefix("torch.")
