"""Clips that are no file of their own: encoded bytes, pictures, arrays, a part of a longer film."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from vidphys.data.clip_files import Decoded, Source
from vidphys.data.formats import VIDEO
from vidphys.data.formats.opencv import MAX_PIXELS, opencv
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256

EARLY = 0.5  # of an interval, by which a stamp may be before the part that it belongs to
OPENCV = "opencv-python-headless"


def encoded(data: Callable[[], bytes], suffix: str) -> Source:
    """The bytes of a video file."""

    def read() -> Decoded:
        def frames() -> Iterator[tuple[np.ndarray, float]]:
            with TemporaryDirectory(prefix="vidphys-") as folder:
                path = Path(folder) / f"clip{suffix}"
                path.write_bytes(data())
                yield from VIDEO.read(path)[2]

        return 0.0, 0, frames()

    return Source(read, lambda: hashlib.sha256(data()).hexdigest(), OPENCV)


def pictures(load: Callable[[], Iterable[bytes]], times: np.ndarray) -> Source:
    """Encoded pictures (JPEG, PNG, WebP), one a frame, at these seconds."""

    def read() -> Decoded:
        return 0.0, len(times), zip(map(_picture, load()), times.tolist(), strict=True)

    def digest() -> str:
        found = hashlib.sha256()
        for each in load():
            found.update(hashlib.sha256(each).digest())
        return found.hexdigest()

    return Source(read, digest, OPENCV)


def _picture(encoded: bytes) -> np.ndarray:
    cv2 = opencv()
    data = np.frombuffer(encoded, np.uint8)
    try:
        found = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    except cv2.error as error:
        raise InputError(f"a picture that OpenCV cannot read ({error.err})") from error
    if found is None:
        raise InputError("a picture that OpenCV cannot read; wants JPEG, PNG or WebP")
    return cv2.cvtColor(found, cv2.COLOR_BGR2RGB)


def frames_in(shape: tuple[int, ...], dtype: np.dtype, what: str) -> None:
    """Refuse an array that holds no frames of a clip.

    Raises:
        InputError: another shape than ``(t, H, W)``, ``(t, H, W, 3)`` or ``(t, 3, H, W)``, or
            other numbers than bytes.
    """
    good = len(shape) == 3 or (len(shape) == 4 and 3 in (shape[-1], shape[1]))
    if not good or 0 in shape:
        raise InputError(f"{what} {shape}; frames are (t, H, W, 3), (t, 3, H, W) or (t, H, W)")
    if np.prod(shape[1:], dtype=float) > 3 * MAX_PIXELS:
        raise InputError(f"{what} {shape}: a frame has more than {MAX_PIXELS} pixels")
    if dtype != np.uint8:
        raise InputError(f"{what} holds {dtype}; frames are uint8, from 0 to 255")


def arrays(frames: Callable[[], Iterable[np.ndarray]], times: np.ndarray, made_by: str) -> Source:
    """Frames ``(H, W, 3)``, ``(3, H, W)`` or ``(H, W)`` of bytes, at these seconds."""

    def read() -> Decoded:
        return 0.0, len(times), zip(map(_upright, frames()), times.tolist(), strict=True)

    def digest() -> str:
        found = hashlib.sha256()
        for picture in map(_upright, frames()):
            found.update(np.ascontiguousarray(picture).data)
        return found.hexdigest()

    return Source(read, digest, made_by)


def _upright(frame: np.ndarray) -> np.ndarray:
    if frame.ndim == 2:
        return np.repeat(frame[..., None], 3, -1)
    return frame if frame.shape[-1] == 3 else np.ascontiguousarray(frame.transpose(1, 2, 0))


def part(film: Path, begin: float, times: np.ndarray) -> Source:
    """The frames of a film from a second on, at these seconds of their own."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else 1.0

    def read() -> Decoded:
        _, _, decoded = VIDEO.read(film)
        inside = (frame for frame, stamp in decoded if stamp > begin - EARLY * step)
        return 0.0, len(times), _paired(film, inside, times)

    def digest() -> str:
        which = f"{sha256(film)} from {begin!r}, {len(times)} frames"
        return hashlib.sha256(which.encode()).hexdigest()

    return Source(read, digest, OPENCV)


def _paired(
    film: Path, frames: Iterator[np.ndarray], times: np.ndarray
) -> Iterator[tuple[np.ndarray, float]]:
    for number, time in enumerate(times.tolist()):
        frame = next(frames, None)
        if frame is None:
            raise InputError(f"{film}: ends after {number} of the {len(times)} frames of its clip")
        yield frame, time
