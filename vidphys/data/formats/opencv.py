"""Clips that OpenCV decodes, by FFmpeg, in a child process that is held to limits."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from vidphys.data.formats import decoder
from vidphys.data.formats.base import Frames
from vidphys.errors import InputError, is_utf8

MAX_PIXELS = 40_000_000  # of a frame; 8K video has 33 million
MEMORY = 3 * 2**29  # bytes that decoding may ask for
SECONDS = 4  # of processor time for a frame, and for opening a clip
PATIENCE = 60.0  # seconds without a byte, on a machine that is busy
LINE = 1000  # bytes of the first line, at most
STILL_PIXELS = 2**26  # of a still picture that is read here
BUFFER = 2**20  # bytes between the processes, where the system lets us say so


def read_clip(path: Path) -> tuple[float, int, Frames]:
    """See :class:`vidphys.data.formats.ClipFormat`.

    Raises:
        InputError: not a video that OpenCV can read, or one that needs more than it may.
    """
    if not is_utf8(str(path)):
        raise InputError(f"{str(path)!a}: the name is not UTF-8; rename the file")
    parts = _decoded(path)
    about = next(parts)
    return about["rate"], int(about["count"]), parts


def _decoded(path: Path) -> Iterator[Any]:
    """What the child says of the clip, then its frames, each with its stamp."""
    child = _Child(path)
    try:
        about = child.line()
        if "error" in about:
            raise InputError(f"{path}: {about['error']}")
        yield {name: x if math.isfinite(x) else 0.0 for name, x in about.items()}
        head = bytearray(decoder.HEAD.size)
        while True:
            child.fill(memoryview(head))
            stamp, height, width = decoder.HEAD.unpack(head)
            if not height:
                return
            if not 0 < height * width <= MAX_PIXELS:
                raise InputError(f"{path}: a frame of {width} x {height} pixels")
            frame = np.empty((height, width, 3), np.uint8)
            child.fill(frame.data.cast("B"))
            yield frame, stamp
    finally:
        child.end()


class _Child:
    """A decoder of this clip; it knows nothing of our folder, environment and packages."""

    def __init__(self, path: Path) -> None:
        self.path = path
        limits = map(str, (MAX_PIXELS, MEMORY, SECONDS))
        command = [sys.executable, "-I", "-S", decoder.__file__, *limits, *_packages()]
        clip = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            self.process = subprocess.Popen(
                command,
                stdin=clip,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={k: v for k, v in os.environ.items() if k == "LD_LIBRARY_PATH"},
                start_new_session=True,
            )
        finally:
            os.close(clip)
        assert self.process.stdout is not None
        self.output = self.process.stdout.fileno()
        self.waiting = select.poll()
        self.waiting.register(self.output, select.POLLIN)
        _widen(self.output)

    def line(self) -> dict[str, Any]:
        """The first line."""
        said, one = bytearray(), bytearray(1)
        while not said.endswith(b"\n") and len(said) < LINE:
            self.fill(memoryview(one))
            said += one
        return json.loads(said)

    def fill(self, room: memoryview) -> None:
        """Read so many bytes.

        Raises:
            InputError: the child ended before, or says nothing any more.
        """
        while room:
            if not self.waiting.poll(1000 * PATIENCE):
                raise InputError(f"{self.path}: decoding it hangs; convert it (mp4, avi, ogv)")
            count = os.readv(self.output, [room])
            if not count:
                raise InputError(f"{self.path}: {self._why()}")
            room = room[count:]

    def end(self) -> None:
        """End it, whatever it is at."""
        self.process.kill()
        assert self.process.stdout is not None
        self.process.stdout.close()
        self.process.wait()

    def _why(self) -> str:
        code = self.process.wait()
        if code == -signal.SIGXCPU:
            return f"decoding a frame takes more than {SECONDS} s; convert it (mp4, avi, ogv)"
        return (
            f"decoding it fails (code {code}), or needs more than {MEMORY / 2**30:g} GiB; "
            "convert it (mp4, avi, ogv)"
        )


def _packages() -> list[str]:
    """Where OpenCV and what it needs lie."""
    found = (importlib.util.find_spec(name) for name in ("cv2", "numpy"))
    homes = [str(Path(s.origin).parents[1]) for s in found if s is not None and s.origin]
    return list(dict.fromkeys(homes))


def _widen(pipe: int) -> None:
    import fcntl

    if hasattr(fcntl, "F_SETPIPE_SZ"):
        try:
            fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, BUFFER)
        except OSError:
            return  # a system that lets a user have less is slower, and no worse


def opencv() -> ModuleType:
    """OpenCV, told not to write its own lines beside ours, nor to open huge pictures."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(STILL_PIXELS))
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    return cv2
