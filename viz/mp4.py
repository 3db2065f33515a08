"""Pictures as a film."""

from __future__ import annotations

import errno
from collections.abc import Iterable
from pathlib import Path

import numpy as np


def draw_mp4(
    path: Path, pictures: Iterable[np.ndarray], rate: float, size: tuple[int, int]
) -> None:
    """Write a film.

    Args:
        path: the file, which :func:`viz.whole.whole` puts into its place.
        pictures: RGB bytes ``(height, width, 3)``.
        rate: of them a second.
        size: (width, height).

    Raises:
        ValueError: OpenCV cannot write such a file.
        OSError: not all of it was written, of which the codec says nothing.
    """
    import cv2

    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, size)
    if not writer.isOpened():
        raise ValueError("OpenCV cannot write it; name a file that ends in .mp4")
    count = 0
    try:
        for picture in pictures:
            writer.write(cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            count += 1
    finally:
        writer.release()
    film = cv2.VideoCapture(str(path))
    if not film.isOpened() or film.get(cv2.CAP_PROP_FRAME_COUNT) != count:
        raise OSError(errno.ENOSPC, "not written whole, the disk may be full", str(path))
