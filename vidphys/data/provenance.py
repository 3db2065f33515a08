"""Where the frames of a clip came from, for the record of what was made of them."""

from __future__ import annotations

import importlib.metadata
from functools import cache
from pathlib import Path
from typing import Any

from vidphys.data.formats import FORMATS, VIDEO, ClipFormat, format_of
from vidphys.data.sets import SETS, set_of
from vidphys.data.video import Video


def provenance(video: Video) -> dict[str, Any]:
    """Which decoder made the frames of a clip, and seconds at which the first of them stands."""
    return {"decoder": decoder_of(video.path), "starts": float(video.times[0])}


def decoder_of(path: Path) -> str:
    """What decodes a clip, with its version."""
    if not path.is_file():
        whole = next(each for each in path.parents if each.exists())
        kind = set_of(whole)
        return next((f"{name} data set" for name, each in SETS.items() if each is kind), "")
    clip = format_of(path, ClipFormat) or VIDEO
    if clip is VIDEO:
        return _opencv()
    if clip.package:
        return f"{clip.package} {_version(clip.package)}"
    name = next(name for name, each in FORMATS.items() if each is clip)
    return f"{name} ({FORMATS.source(name)})"


# Looking up a version reads files, for each of a million clips.
_version = cache(importlib.metadata.version)


@cache
def _opencv() -> str:
    found = (name for name in ("opencv-python-headless", "opencv-python") if _installed(name))
    name = next(found, "")
    return f"OpenCV {_version(name) if name else ''}".strip()


def _installed(distribution: str) -> bool:
    try:
        importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True
