"""The user's clip: its frames with their time stamps, and what the container got wrong.

Containers state a frame rate and a frame count; both can be false. Frames are counted by decoding
them once, and times are the presentation stamps. The frames of a long clip are not held: each use
decodes them again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from vidphys.data.clip_files import Decoded
from vidphys.data.clip_files import Source as ClipSource
from vidphys.data.formats import FORMATS, VIDEO, ClipFormat, format_of
from vidphys.data.formats.opencv import opencv
from vidphys.data.formats.stamps import unrounded
from vidphys.data.frames import Frames, Holding, Source
from vidphys.data.sets import clip_in_set
from vidphys.errors import InputError
from vidphys.runs.atomic import sha256

RATE_TOLERANCE = 0.01
GAP = 1.5
FRAMES_FOR_MOMENTUM = 3


@dataclass(frozen=True)
class ClipSelection:
    """Which part of a clip is read, and how large.

    Args:
        start: first frame, counted by decoding.
        stop: frame to stop before; all where not given.
        stride: take each ``stride``-th frame.
        side: shrink frames so that their longer side has at most this many pixels.
        rate: frames per second, in place of the container's stamps where they are known to be
            wrong (high-speed recordings, AVI).
    """

    start: int = 0
    stop: int | None = None
    stride: int = 1
    side: int | None = None
    rate: float | None = None

    def takes(self, number: int) -> bool:
        """Whether it is a frame with this number."""
        past = self.stop is not None and number >= self.stop
        return number >= self.start and not past and (number - self.start) % self.stride == 0


@dataclass(frozen=True)
class Video:
    """An opened clip.

    Args:
        path: the file, and ``sha256`` its hash.
        frames: uint8 ``(t, H, W, 3)``, RGB, row 0 on top; decoded when they are asked for.
        times: seconds of each frame, float64 ``(t,)``.
        indices: number of each frame, counted by decoding from 0, int64 ``(t,)``.
        notes: where the container's word and what was decoded disagree, a line each.
        decoder: what makes the frames, with its version.
    """

    path: Path
    sha256: str
    frames: Frames
    times: np.ndarray
    indices: np.ndarray
    notes: tuple[str, ...]
    decoder: str = ""

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) of the frames."""
        return self.frames.shape[1], self.frames.shape[2]

    @property
    def interval(self) -> float:
        """Median seconds between frames.

        Raises:
            InputError: fewer than two frames.
        """
        if len(self.times) < 2:
            raise InputError(f"{self.path}: one frame has no frame interval; give a longer clip")
        return float(np.median(np.diff(self.times)))

    @property
    def made(self) -> dict[str, Any]:
        """For a manifest of features: what made the frames, and the seconds of the first."""
        return {"decoder": self.decoder, "starts": float(self.times[0])}


def open_video(path: Path, selection: ClipSelection) -> Video:
    """Count the frames of a clip by the format that it is of; by OpenCV where none is known.

    Raises:
        InputError: a selection that makes no sense, a missing file, not a video, no frame that can
            be decoded, or stamps that do not increase and no ``rate`` in their place.
    """
    _check(selection)
    source = None if path.is_file() else clip_in_set(path).source
    declared_rate, declared_count, decoded = _decoding(path, source)
    held, stamps, indices = Holding(), [], []
    for count, (frame, stamp) in enumerate(islice(decoded, selection.stop)):
        stamps.append(stamp)
        if selection.takes(count):
            try:
                held.add(_shrink(frame, selection.side))
            except ValueError as error:
                raise InputError(f"{path}: frame {count} is {error}; convert the clip") from error
            indices.append(count)
    if not stamps:
        raise InputError(
            f"{path}: opens, but none of its frames can be decoded: it is cut short, or of a codec "
            "that OpenCV does not have (AV1 is one); convert it: ffmpeg -i CLIP clip.mp4"
        )
    if held.size is None:
        raise InputError(
            f"{path}: no frame could be decoded in the selection (frames {selection.start} to "
            f"{selection.stop or 'the end'}; {len(stamps)} were decoded); check the file and "
            "`start`"
        )
    times, notes = _times(path, np.array(stamps), selection.rate)
    notes += _count_note(declared_count, len(stamps), ended=selection.stop is None)
    if selection.rate is None:
        notes += _rate_notes(declared_rate, times)
    chosen = np.array(indices)

    def again() -> Iterator[np.ndarray]:
        return _chosen(path, source, selection, len(chosen))

    frames = Frames(Source(again, len(chosen), held.size, held.all()))
    whose = sha256(path) if source is None else source.sha256()
    made_by = _made_by(path) if source is None else _versioned(source.made_by)
    return Video(path, whose, frames, times[chosen], chosen, tuple(notes), made_by)


def _made_by(path: Path) -> str:
    """What makes frames of a file, with its version."""
    format = format_of(path, ClipFormat) or VIDEO
    if format.package:
        return _versioned(format.package)
    name = next(name for name, each in FORMATS.items() if each is format)
    return next(iter(FORMATS.sources(name).values()), name)


@cache  # to look a version up reads files, and there may be a million clips
def _versioned(package: str) -> str:
    return f"{package} {version(package)}"


def _decoding(path: Path, source: ClipSource | None) -> Decoded:
    """See :class:`vidphys.data.formats.ClipFormat`."""
    clip = format_of(path, ClipFormat) or VIDEO
    try:
        return clip.read(path) if source is None else source.read()
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path}: {error}") from error


def _chosen(
    path: Path, source: ClipSource | None, selection: ClipSelection, count: int
) -> Iterator[np.ndarray]:
    """So many frames, decoded once more."""
    *_, decoded = _decoding(path, source)
    given = 0
    for number, (frame, _) in enumerate(decoded):
        if selection.takes(number):
            yield _shrink(frame, selection.side)
            given += 1
        if given == count:
            return
    raise InputError(
        f"{path}: had {count} frames and now has {given}; it changed while it was read"
    )


def require_frames(video: Video, least: int = FRAMES_FOR_MOMENTUM) -> None:
    """Refuse a clip that is too short to show momentum.

    Raises:
        InputError: fewer than ``least`` frames.
    """
    if len(video.frames) < least:
        raise InputError(
            f"{video.path}: momentum needs at least {least} frames, the selection has "
            f"{len(video.frames)}; one frame shows places, not speeds: give a longer clip"
        )


def _check(selection: ClipSelection) -> None:
    stop = selection.stop
    if selection.start < 0 or (stop is not None and stop <= selection.start):
        raise InputError(f"frames {selection.start} to {stop}: must be 0 <= start < stop")
    if selection.stride < 1:
        raise InputError(f"stride {selection.stride}: must be at least 1")
    if selection.rate is not None and not selection.rate > 0:
        raise InputError(f"rate {selection.rate}: must be above 0 frames per second")
    if selection.side is not None and selection.side < 1:
        raise InputError(f"side {selection.side}: must be at least 1 pixel")


def _shrink(frame: np.ndarray, side: int | None) -> np.ndarray:
    height, width = frame.shape[:2]
    if side is None or max(height, width) <= side:
        return frame
    scale = side / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    cv2 = opencv()
    return cv2.resize(frame, size, interpolation=cv2.INTER_AREA)


def _times(path: Path, stamps: np.ndarray, rate: float | None) -> tuple[np.ndarray, list[str]]:
    """Increasing times; a stamp that does not increase is replaced by the median interval."""
    if rate is not None:
        return np.arange(len(stamps)) / rate, [f"times from the given rate, {rate:g} per second"]
    if not np.isfinite(stamps).all():
        raise InputError(f"{path}: frames without times; give the frames per second as `rate`")
    if len(stamps) == 1:
        return stamps, []
    steps = np.diff(stamps)
    good = steps > 0
    if 2 * good.sum() < len(steps):
        raise InputError(
            f"{path}: {int((~good).sum())} of {len(stamps)} presentation stamps do not increase; "
            "give the frame rate as `rate`"
        )
    if good.all():
        return unrounded(stamps)[0], []
    usual = float(np.median(steps[good]))
    times = stamps.copy()
    replaced = 0
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            times[i] = times[i - 1] + usual
            replaced += 1
    return times, [
        f"{replaced} presentation stamps do not increase; replaced by {usual:.4g} s steps"
    ]


def _count_note(declared: int, decoded: int, ended: bool) -> list[str]:
    none = declared <= 1  # a container of MPEG has no count, and OpenCV says 1
    if not ended or none or declared == decoded:
        return []
    return [f"the container declares {declared} frames, {decoded} were decoded"]


def _rate_notes(declared: float, times: np.ndarray) -> list[str]:
    if len(times) < 2:
        return []
    notes, steps = [], np.diff(times)
    measured = len(steps) / (times[-1] - times[0])
    if declared > 0 and abs(measured / declared - 1) > RATE_TOLERANCE:
        notes.append(
            f"the container declares {declared:.4g} frames per second, the stamps give "
            f"{measured:.4g} on average"
        )
    gaps = np.nonzero(steps > GAP * np.median(steps))[0]
    if len(gaps):
        notes.append(
            f"gaps in time: {len(gaps)}; the first follows frame {gaps[0]} and lasts "
            f"{steps[gaps[0]]:.4g} s, usual are {np.median(steps):.4g} s"
        )
    return notes
