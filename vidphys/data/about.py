"""How a clip was read, for a record: by what, from when on, and what is odd about it."""

from __future__ import annotations

from typing import Any

from vidphys.data.evenness import JITTER, jitter
from vidphys.data.video import Video

FITTED = "dynamics are fitted to tracks at even times, read off by the time stamps"


def about_video(video: Video, uneven: str = FITTED) -> dict[str, Any]:
    """What a run keeps of a clip that it read.

    Args:
        video: the clip.
        uneven: what becomes of frames that come unevenly, in words.
    """
    return {
        "clip": video.path.name,
        "sha256": video.sha256,
        "decoder": video.decoder,
        "frames": len(video.indices),
        "first_frame": int(video.indices[0]),
        "first_seconds": float(video.times[0]),
        "notes": _notes(video, uneven),
    }


def _notes(video: Video, then: str) -> list[str]:
    """What is odd about a clip, a line each."""
    late = jitter(video.times)
    if late <= JITTER:
        return list(video.notes)
    uneven = f"frames come unevenly, up to {late:.2g} intervals early or late; {then}"
    return [*video.notes, uneven]
