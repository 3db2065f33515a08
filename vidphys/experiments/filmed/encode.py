"""A clip's file: H.264 with a stamp a frame, as a phone writes it."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.errors import InputError

TICKS = 90000  # of the stamps, a second


def require_av() -> Any:
    """PyAV.

    Raises:
        InputError: it is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise InputError(
            "film: H.264 needs PyAV, which is not installed; `pip install vidphys[filmed]`"
        ) from error
    return av


def write_h264(
    path: Path, frames: Iterable[np.ndarray], stamps: np.ndarray, rate: float, crf: int
) -> None:
    """Write RGB frames ``(H, W, 3)``, bytes, as MP4.

    Args:
        path: the file.
        frames: one for each stamp.
        stamps: seconds, ``(t,)``.
        rate: frames per second that the container declares.
        crf: of x264; larger is worse.
    """
    av = require_av()
    with av.open(str(path), "w", format="mp4") as container:
        stream = None
        for frame, stamp in zip(frames, stamps, strict=True):
            if stream is None:
                stream = container.add_stream(
                    "libx264", rate=Fraction(rate).limit_denominator(1001)
                )
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.options = {"crf": str(crf), "preset": "veryfast"}
                stream.codec_context.time_base = Fraction(1, TICKS)
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            picture.pts, picture.time_base = round(stamp * TICKS), Fraction(1, TICKS)
            container.mux(stream.encode(picture))
        if stream is not None:
            container.mux(stream.encode(None))
