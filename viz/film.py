"""A film of a clip: track, forecast and changed law drawn over its frames, as a video file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from viz.overlay import world_to_pixel
from viz.recording import COLOURS, VIDEO_ARRAYS
from viz.showcase import Arrays, check_video, half_extent

TRAIL = 1.0  # seconds of a path that are shown behind a body
DIMMED = 0.35  # of a frame's brightness, after the clip has ended
LEAST = 320  # pixels of the longer side, below which frames are enlarged
NAMES = {
    "observed": "observed",
    "readout": "track",
    "rollout": "forecast",
}


def write_film(video: Arrays, path: Path, law: str = "another law") -> None:
    """Write the frames of a clip with what is known and foretold of its bodies drawn over them.

    Args:
        video: as :func:`viz.recording.write_overlay_recording` takes it. The film goes on, over
            the last frame dimmed, until the rollout ends.
        path: the ``.mp4`` to write.
        law: what ``changed`` is called.

    Raises:
        ValueError: an array is missing or has the wrong shape, or OpenCV cannot write such a file.
    """
    import cv2

    check_video(video)
    times = np.asarray(video["frame_times"], np.float64)
    interval = float(np.median(np.diff(times)))
    pictures = _pictures(video, times, interval)
    _, first = next(pictures)
    zoom = max(1, -(-LEAST // max(first.shape[:2])))
    size = zoom * first.shape[1] // 2 * 2, zoom * first.shape[0] // 2 * 2  # the codec wants even
    path.parent.mkdir(parents=True, exist_ok=True)
    code = cv2.VideoWriter.fourcc(*"mp4v")
    writer = cv2.VideoWriter(str(path), code, 1 / interval, size)
    if not writer.isOpened():
        raise ValueError(f"write_film: OpenCV cannot write {path}; name a file that ends in .mp4")
    try:
        for time, picture in _pictures(video, times, interval):
            canvas = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
            _draw(canvas, video, time, law)
            writer.write(cv2.cvtColor(canvas, cv2.COLOR_RGB2BGR))
    finally:
        writer.release()


def _pictures(
    video: Arrays, times: np.ndarray, interval: float
) -> Iterator[tuple[float, np.ndarray]]:
    """Frames with their times, and the last one again, dimmed, until nothing more is foretold."""
    yield from zip(times.tolist(), video["frames"], strict=True)
    last = (DIMMED * video["frames"][-1]).astype(np.uint8)
    ends = [float(video[key][-1]) for key in ("rollout_times", "changed_times") if key in video]
    for k in range(1, round((max(ends) - times[-1]) / interval) + 1):
        yield float(times[-1] + k * interval), last


def _draw(canvas: np.ndarray, video: Arrays, time: float, law: str) -> None:
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
        shown.append((role, NAMES.get(role, law)))
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
