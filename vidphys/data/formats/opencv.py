"""Clips that OpenCV decodes, by FFmpeg, in a child process that is held to limits."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from vidphys.data.formats.base import Frames
from vidphys.data.formats.child import Child
from vidphys.data.formats.children.confined import HEAD
from vidphys.errors import InputError, is_utf8

MAX_PIXELS = 40_000_000  # of a frame; 8K video has 33 million
MEMORY = 3 * 2**29  # bytes that decoding may ask for
SECONDS = 4  # of processor time for a frame, and for opening a clip
STILL_PIXELS = 2**26  # of a still picture that is read here


def read_clip(path: Path) -> tuple[float, int, Frames]:
    """See :class:`vidphys.data.formats.ClipFormat`.

    Raises:
        InputError: not a video that OpenCV can read, or one that needs more than it may.
    """
    if not is_utf8(str(path)):
        raise InputError(f"{str(path)!a}: the name is not UTF-8; rename the file")
    return decoded_apart(path, "clip.py", "cv2")


def decoded_apart(path: Path, program: str, package: str) -> tuple[float, int, Frames]:
    """The same by one of the programs that decode frames, which needs a package.

    Raises:
        InputError: it cannot decode them, or they need more than they may.
    """
    parts = _decoded(path, program, package)
    about = next(parts)
    return about["rate"], int(about["count"]), parts


def _decoded(path: Path, program: str, package: str) -> Iterator[Any]:
    """What the child says of the clip, then its frames, each with its stamp."""
    limits = (MAX_PIXELS, MEMORY, SECONDS)
    try:
        with Child(path, program, limits, [package], "convert it (mp4, avi, ogv)") as child:
            about = child.message()
            yield {name: x if math.isfinite(x) else 0.0 for name, x in about.items()}
            while (frame := _frame(child)) is not None:
                yield frame
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _frame(child: Child) -> tuple[np.ndarray, float] | None:
    """The next frame and its stamp, ``None`` after the last."""
    head = bytearray(HEAD.size)
    child.fill(memoryview(head))
    stamp, height, width = HEAD.unpack(head)
    if not height:
        return None
    if not 0 < height * width <= MAX_PIXELS:
        raise InputError(f"a frame of {width} x {height} pixels")
    frame = np.empty((height, width, 3), np.uint8)
    child.fill(frame.data.cast("B"))
    return frame, stamp


def opencv() -> ModuleType:
    """OpenCV, told not to write its own lines beside ours, nor to open huge pictures."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(STILL_PIXELS))
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2
