"""How a clip was read, for a record: by what, from when on, and what is odd about it."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from vidphys.data.evenness import JITTER, jitter
from vidphys.data.formats import FORMATS, VIDEO, ClipFormat, format_of
from vidphys.data.video import Video

OPENCV = "opencv-python-headless"


def about_video(video: Video) -> dict[str, Any]:
    """What a run keeps of a clip that it read."""
    return {
        "clip": video.path.name,
        "sha256": video.sha256,
        "decoder": decoder_of(video),
        "frames": len(video.indices),
        "first_frame": int(video.indices[0]),
        "first_seconds": float(video.times[0]),
        "notes": notes_of(video),
    }


def notes_of(video: Video) -> list[str]:
    """What is odd about a clip, a line each."""
    late = jitter(video.times)
    if late <= JITTER:
        return list(video.notes)
    uneven = (
        f"frames come unevenly, up to {late:.2g} intervals early or late; dynamics are fitted to "
        "tracks at even times, read off by the time stamps"
    )
    return [*video.notes, uneven]


def decoder_of(video: Video) -> str:
    """What made the frames of the bytes, with its version."""
    format = format_of(video.path, ClipFormat) or VIDEO
    if format is VIDEO:
        return f"{OPENCV} {version(OPENCV)}"
    name = next(name for name, each in FORMATS.items() if each is format)
    return FORMATS.sources(name).get(name, name)
