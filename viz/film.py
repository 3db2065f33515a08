"""A film of a clip: track, forecast and changed law drawn over its frames, as a video file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from viz.mp4 import draw_mp4
from viz.overlay import world_to_pixel
from viz.recording import COLOURS, VIDEO_ARRAYS
from viz.showcase import Arrays, check_video, half_extent
from viz.whole import whole

TRAIL = 1.0  # seconds of a path that are shown behind a body
DIMMED = 0.35  # of a frame's brightness, after the clip has ended
LEAST = 320  # pixels of the longer side, below which frames are enlarged


def write_film(
    video: Arrays, path: Path, law: str = "another law", foretold: str = "forecast"
) -> None:
    """Write the frames of a clip with what is known and foretold of its bodies drawn over them.

    Args:
        video: as :func:`viz.recording.write_overlay_recording` takes it. The film goes on, over
            the last frame dimmed, until the rollout ends.
        path: the ``.mp4`` to write, replaced as a whole or not at all.
        law: what ``changed`` is called.
        foretold: what ``rollout`` is called.

    Raises:
        ValueError: an array is missing or has the wrong shape, or OpenCV cannot write such a file.
        OSError: the disk is full.
    """
    check_video(video)
    times = np.asarray(video["frame_times"], np.float64)
    interval = float(np.median(np.diff(times)))
    height, width = video["frames"].shape[1:3]
    zoom = max(1, -(-LEAST // max(height, width)))
    size = zoom * width // 2 * 2, zoom * height // 2 * 2  # the codec wants even
    pictures = _pictures(video, times, interval)
    names = {"observed": "observed", "readout": "track", "rollout": foretold, "changed": law}
    with whole(path) as part:
        draw_mp4(part, _drawn(video, pictures, size, names), 1 / interval, size)


def _drawn(
    video: Arrays,
    pictures: Iterable[tuple[float, np.ndarray]],
    size: tuple[int, int],
    names: Mapping[str, str],
) -> Iterator[np.ndarray]:
    import cv2

    for time, picture in pictures:
        canvas = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        _draw(canvas, video, time, names)
        yield canvas


def _pictures(
    video: Arrays, times: np.ndarray, interval: float
) -> Iterator[tuple[float, np.ndarray]]:
    """Frames with their times, and the last one again, dimmed, until nothing more is foretold."""
    yield from zip(times.tolist(), video["frames"], strict=True)
    last = (DIMMED * video["frames"][-1]).astype(np.uint8)
    ends = [float(video[key][-1]) for key in ("rollout_times", "changed_times") if key in video]
    for k in range(1, round((max(ends) - times[-1]) / interval) + 1):
        yield float(times[-1] + k * interval), last


def _draw(canvas: np.ndarray, video: Arrays, time: float, names: Mapping[str, str]) -> None:
    """All paths of the last second, each with a dot where its body is at this time."""
    import cv2

    height, width = canvas.shape[:2]
    thick = max(1, round(max(height, width) / 400))
    shown: list[tuple[str, str]] = []
    for role, (key, stamps) in VIDEO_ARRAYS.items():
        if key not in video:
            continue
        when = np.asarray(video[stamps], np.float64)
        pixels = world_to_pixel(video[key], (height, width), half_extent(video))
        shown.append((role, names[role]))
        if not when[0] - 1e-9 <= time <= when[-1] + 1e-9:
            continue
        recent = (when > time - TRAIL) & (when <= time + 1e-9)
        for body in range(pixels.shape[1]):
            path = pixels[recent, body]
            path = np.clip(path[np.isfinite(path).all(-1)], -1e4, 1e4).round().astype(np.int32)
            if len(path):
                cv2.polylines(canvas, [path], False, COLOURS[role], thick, cv2.LINE_AA)
                cv2.circle(canvas, path[-1].tolist(), 3 * thick, COLOURS[role], thick, cv2.LINE_AA)
    _legend(canvas, shown, thick)


def _legend(canvas: np.ndarray, roles: list[tuple[str, str]], thick: int) -> None:
    import cv2

    size = 0.4 * thick
    for row, (role, name) in enumerate(roles, 1):
        at = (8 * thick, 16 * thick * row)
        for colour, width in (((0, 0, 0), 2 * thick + 1), (COLOURS[role], thick)):
            cv2.putText(
                canvas, name, at, cv2.FONT_HERSHEY_SIMPLEX, size, colour, width, cv2.LINE_AA
            )
