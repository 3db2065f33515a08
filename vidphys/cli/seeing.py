"""Which frames of clips are seen, and through which frozen encoder: options that verbs share."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from vidphys.data.video import ClipSelection
from vidphys.errors import InputError


@dataclass(frozen=True, kw_only=True)
class SeeingOptions:
    """How a verb sees its clips. An encoder's option that is not given keeps its own default.

    Args:
        encoder: the frozen encoder; `vidphys parts` names them. timm:NAME is any image network of
            timm, hf:FOLDER any vision or video model of transformers in its official layout, and
            package.module:factory one of yours. The default comes with the package. An option
            that it does not take is refused.
        weights: file or folder of its weights; else VIDPHYS_WEIGHTS, else the user's cache.
        resolution: network pixels of the longer image side.
        frames: how many frames are in a window of a video encoder.
        hop: frames from a window's start to the next one's.
        frame_stride: let the encoder take each so-many-th of the frames.
        options: further options of the encoder, NAME=VALUE, such as shown=2 for i3d.
        predictor: read the predictor of V-JEPA 2 in place of its encoder.
        dtype: number format in which the encoder computes.
        device: where the encoder runs.
        start: first frame of each clip that is seen (a hand may hold the body before it).
        stop: frame to stop before.
        stride: take each so-many-th frame.
        side: shrink frames so that their longer side has at most this many pixels.
        rate: frames per second, in place of the container's time stamps.
    """

    encoder: str = "dino-tiny"
    weights: Path | None = None
    resolution: int | None = None
    frames: int | None = None
    hop: int | None = None
    frame_stride: int | None = None
    options: tuple[str, ...] = ()
    predictor: bool = False
    dtype: Literal["float32", "bfloat16", "float16"] | None = None
    device: Literal["cpu", "cuda"] = "cpu"
    start: int = 0
    stop: int | None = None
    stride: int = 1
    side: int | None = None
    rate: float | None = None

    @property
    def selection(self) -> ClipSelection:
        """Which frames are read."""
        return ClipSelection(self.start, self.stop, self.stride, self.side, self.rate)

    @property
    def encoder_options(self) -> dict[str, Any]:
        """What the encoder is set to; ``None`` is its own default.

        Raises:
            InputError: a further option that is not NAME=VALUE.
        """
        names = ("resolution", "frames", "hop", "frame_stride", "dtype")
        return {
            **{name: getattr(self, name) for name in names},
            "predictor": self.predictor or None,
            **dict(map(_option, self.options)),
        }


def _option(text: str) -> tuple[str, int | float | bool | str]:
    name, sign, value = text.partition("=")
    if not (name and sign):
        raise InputError(f"--options {text}: write NAME=VALUE, for example shown=2")
    try:
        return name, json.loads(value)
    except ValueError:
        return name, value
