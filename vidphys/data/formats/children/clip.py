"""The program that decodes one clip.

After its message come the frames, each as :data:`confined.HEAD` and its RGB bytes, then an empty
head.
"""

from __future__ import annotations

import contextlib
import os
import sys

from confined import FILE, HEAD, allow, confine, say, write

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

    confine(memory)
    allow(seconds)
    capture = cv2.VideoCapture(FILE, cv2.CAP_FFMPEG)
    if not capture.isOpened():
        say({"error": "not a video that OpenCV can read; convert it (mp4, avi, ogv)"})
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
        say({"error": f"frames of {width:.0f} x {height:.0f} pixels, more than {most_pixels}"})
        return
    say({"rate": rate, "count": count})
    while True:
        allow(seconds)
        good, frame = capture.read()
        if not good:
            break
        stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        write(HEAD.pack(stamp, *frame.shape[:2]))
        write(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB).data)
    write(HEAD.pack(0.0, 0, 0))


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        main(*map(int, sys.argv[1:]))
