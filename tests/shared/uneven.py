"""A clip whose frames come at times of their own."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np


def write_uneven(path: Path, frames: np.ndarray, times: np.ndarray) -> None:
    """Write RGB ``frames (t, H, W, 3)`` at these times, in milliseconds."""
    import av

    with av.open(str(path), "w") as out:
        stream = out.add_stream("ffv1", rate=25, options={"strict": "experimental"})
        stream.width, stream.height, stream.pix_fmt = frames.shape[2], frames.shape[1], "bgr0"
        stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        for frame, time in zip(frames, times, strict=True):
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24").reformat(format="bgr0")
            picture.pts, picture.time_base = round(1000 * time), Fraction(1, 1000)
            out.mux(stream.encode(picture))
        out.mux(stream.encode(None))
