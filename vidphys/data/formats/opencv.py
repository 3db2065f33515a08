"""Clips that OpenCV decodes, by FFmpeg."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

from vidphys.data.formats.base import Frames
from vidphys.errors import InputError, is_utf8


def read_clip(path: Path) -> tuple[float, int, Frames]:
    """See :class:`vidphys.data.formats.ClipFormat`.

    Raises:
        InputError: not a video that OpenCV can read.
    """
    if not is_utf8(str(path)):  # in OpenCV, a segmentation fault
        raise InputError(f"{str(path)!a}: the name is not UTF-8; rename the file")
    cv2 = opencv()
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(f"{path}: not a video that OpenCV can read; convert it (mp4, avi, ogv)")

    def decode() -> Frames:
        try:
            while True:
                good, frame = capture.read()
                if not good:
                    return
                stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
                yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), stamp
        finally:
            capture.release()

    rate, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
    return float(rate), int(count), decode()


def opencv() -> ModuleType:
    """OpenCV, told not to write its own lines beside ours."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2
