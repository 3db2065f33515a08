"""The program that decodes one clip.

After its message come the frames, each as :data:`confined.HEAD` and its RGB bytes, then an empty
head.
"""

from __future__ import annotations

import contextlib
import os
import sys

from confined import FILE, HEAD, allow, confine, say, write

# No playlist, no list of files.
CONTAINERS = "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,ogg,gif,mpeg,mpegts,asf,flv"
STREAMS = "mpegvideo,h264,hevc,yuv4mpegpipe"  # of no container
ODDEST = 4.0  # times as wide as high, or the other way round, that a pixel is said to be in earnest
OPTIONS = f"format_whitelist;{CONTAINERS},{STREAMS}|protocol_whitelist;file"


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
    width, height, rate, count, over, under, turned = (
        capture.get(what)
        for what in (
            cv2.CAP_PROP_FRAME_WIDTH,
            cv2.CAP_PROP_FRAME_HEIGHT,
            cv2.CAP_PROP_FPS,
            cv2.CAP_PROP_FRAME_COUNT,
            cv2.CAP_PROP_SAR_NUM,
            cv2.CAP_PROP_SAR_DEN,
            cv2.CAP_PROP_ORIENTATION_META,
        )
    )
    stored = int(width), int(height)
    wide = over / under if over > 0 and under > 0 else 1.0
    shape = _square(*stored, 1 / wide if turned % 180 else wide)  # it is turned as it is decoded
    if shape[0] * shape[1] > most_pixels:
        say({"error": f"frames of {shape[0]} x {shape[1]} pixels, more than {most_pixels}"})
        return
    say({"rate": rate, "count": count})
    while True:
        allow(seconds)
        good, frame = capture.read()
        if not good:
            break
        stamp = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        if shape != stored == frame.shape[1::-1]:
            frame = cv2.resize(frame, shape, interpolation=cv2.INTER_CUBIC)
        write(HEAD.pack(stamp, *frame.shape[:2]))
        write(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB).data)
    write(HEAD.pack(0.0, 0, 0))


def _square(width: int, height: int, wide: float) -> tuple[int, int]:
    """Width and height of a picture in square pixels, as a player shows it.

    A picture whose pixels are stored wide or narrow is made larger along one way: a circle in it
    would be no circle, and a length not the same along both.
    """
    if not 1 / ODDEST < wide < ODDEST:
        return width, height
    return round(width * max(wide, 1.0)), round(height * max(1 / wide, 1.0))


if __name__ == "__main__":
    with contextlib.suppress(BrokenPipeError, KeyboardInterrupt):
        main(*map(int, sys.argv[1:]))
