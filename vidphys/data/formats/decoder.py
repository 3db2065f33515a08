"""The program that decodes one clip, in a process of its own with little to do harm with.

It is run as a file, so that it imports nothing of ours. The clip is its standard input; its whole
output is a line of JSON, then each frame as :data:`HEAD` and its RGB bytes, then an empty head.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import struct
import sys
from typing import Any

CLIP = "/dev/fd/0"
FILES = 4  # open at once: the three that it has, and the clip by its name; so no socket either
HEAD = struct.Struct("<dII")  # seconds, height, width; no rows: the end
CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,ogg"  # no playlist, no list of files
OPTIONS = f"format_whitelist;{CONTAINERS}|protocol_whitelist;file"


def main(most_pixels: int, memory: int, seconds: int) -> None:
    """Decode the clip.

    Args:
        most_pixels: of a frame.
        memory: bytes that may be asked for, on top of those of the libraries.
        seconds: of processor time, for opening it and for each frame.
    """
    os.environ |= {"OPENCV_FFMPEG_LOGLEVEL": "-8", "OPENCV_FFMPEG_CAPTURE_OPTIONS": OPTIONS}
    import cv2

    _confine(memory)
    _allow(seconds)
    capture = cv2.VideoCapture(CLIP, cv2.CAP_FFMPEG)
    if not capture.isOpened():
        _say({"error": "not a video that OpenCV can read; convert it (mp4, avi, ogv)"})
        return
    width, height, rate, count = (
        capture.get(what)
        for what in (
            cv2.CAP_PROP_FRAME_WIDTH,
            cv2.CAP_PROP_FRAME_HEIGHT,
            cv2.CAP_PROP_FPS,
            cv2.CAP_PROP_FRAME_COUNT,
        )
    )
    if width * height > most_pixels:
        _say({"error": f"frames of {width:.0f} x {height:.0f} pixels, more than {most_pixels}"})
        return
    _say({"rate": rate, "count": count})
    while True:
        _allow(seconds)
        good, frame = capture.read()
        if not good:
            break
        stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        _write(HEAD.pack(stamp, *frame.shape[:2]))
        _write(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB).data)
    _write(HEAD.pack(0.0, 0, 0))


def _confine(memory: int) -> None:
    """From here on: so much memory, one more open file, none written, no core left behind."""
    if sys.platform == "linux":
        with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a start counts
            held = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (held + memory, held + memory))
    for what, most in (
        (resource.RLIMIT_CORE, 0),
        (resource.RLIMIT_FSIZE, 0),
        (resource.RLIMIT_NOFILE, FILES),
    ):
        resource.setrlimit(what, (most, most))


def _allow(seconds: int) -> None:
    """So much more processor time."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    until = int(used.ru_utime + used.ru_stime) + 1 + seconds
    resource.setrlimit(resource.RLIMIT_CPU, (until, resource.RLIM_INFINITY))


def _say(words: dict[str, Any]) -> None:
    _write(json.dumps(words).encode() + b"\n")


def _write(data: Any) -> None:
    rest = memoryview(data).cast("B")
    while rest:
        rest = rest[os.write(1, rest) :]


if __name__ == "__main__":
    sys.path += sys.argv[4:]
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        main(*map(int, sys.argv[1:4]))
