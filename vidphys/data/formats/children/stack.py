"""The program that decodes the pictures of one file: a TIFF stack, an animated WebP or PNG.

It answers as that of clips does. A picture whose values are no bytes is shown between the darkest
and the brightest value of the whole stack.
"""

from __future__ import annotations

import contextlib
import re
import sys
from typing import Any

import numpy as np
from confined import HEAD, allow, confine, say, write

KINDS = ["TIFF", "WEBP", "PNG"]
BYTES = ("1", "L", "P", "LA", "PA", "RGB", "RGBA", "RGBX", "CMYK", "YCbCr", "LAB", "HSV")
DESCRIPTION = 270  # the tag in which ImageJ says the seconds between frames
INTERVAL = re.compile(r"^finterval=([0-9.eE+-]+)$", re.MULTILINE)


def main(most_pixels: int, memory: int, seconds: int) -> None:
    """Decode the stack; see :mod:`.clip`."""
    from PIL import Image

    Image.init()  # what reads a kind of picture is a file, which is not to be opened later
    Image.MAX_IMAGE_PIXELS = None  # they are counted here
    confine(memory)
    allow(seconds)
    try:
        stack = Image.open(sys.stdin.buffer, formats=KINDS)
        count, size = getattr(stack, "n_frames", 1), stack.size
    except Exception:
        say({"error": "not pictures that Pillow can read; convert it (mp4, avi, ogv)"})
        return
    if size[0] * size[1] > most_pixels:
        say({"error": f"frames of {size[0]} x {size[1]} pixels, more than {most_pixels}"})
        return
    interval = _interval(stack)
    try:
        span = _span(stack, count, most_pixels, seconds)
    except Exception:
        say({"error": "a picture of it cannot be decoded; convert it (mp4, avi, ogv)"})
        return
    say({"rate": 1 / interval if interval else 0.0, "count": count})
    stamp = 0.0
    for number in range(count):
        allow(seconds)
        picture = _picture(stack, number, most_pixels)
        shown = _as_bytes(picture, span)
        lasts = float(stack.info.get("duration", 0.0)) / 1000 or interval
        write(HEAD.pack(stamp if lasts else np.nan, *shown.shape[:2]))
        write(np.ascontiguousarray(shown))
        stamp += lasts
    write(HEAD.pack(0.0, 0, 0))


def _picture(stack: Any, number: int, most_pixels: int) -> Any:
    """One of them; its size may be its own."""
    stack.seek(number)
    if stack.size[0] * stack.size[1] > most_pixels:
        raise ValueError("too many pixels")
    return stack


def _interval(stack: Any) -> float:
    """Seconds between frames, as ImageJ writes them; 0 where nothing is said."""
    told = getattr(stack, "tag_v2", {}).get(DESCRIPTION, "")
    found = INTERVAL.search(told) if isinstance(told, str) and "tunit" not in told else None
    with contextlib.suppress(ValueError):
        return max(float(found[1]), 0.0) if found else 0.0
    return 0.0


def _span(stack: Any, count: int, most_pixels: int, seconds: int) -> tuple[float, float] | None:
    """The darkest and the brightest value; ``None`` where values are bytes."""
    if stack.mode in BYTES:
        return None
    low, high = np.inf, -np.inf
    for number in range(count):
        allow(seconds)
        values = np.asarray(_picture(stack, number, most_pixels), float)
        values = values[np.isfinite(values)]
        if values.size:
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    return (low, high) if high > low else (low, low + 1.0)


def _as_bytes(picture: Any, span: tuple[float, float] | None) -> np.ndarray:
    """RGB, ``(h, w, 3)``."""
    if span is None:
        return np.asarray(picture.convert("RGB"))
    share = (np.nan_to_num(np.asarray(picture, float), nan=span[0]) - span[0]) / (span[1] - span[0])
    return np.repeat(np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8)[..., None], 3, -1)


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        main(*map(int, sys.argv[1:]))
