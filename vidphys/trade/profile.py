"""The compact file that a choice travels in: measured points, and where they were measured.

``vidphys trade`` writes one with the points of all fronts; a pick writes one with what was chosen,
and a verb takes its options from that one with ``--profile FILE``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from vidphys.atomic import write_json
from vidphys.errors import InputError
from vidphys.trade.point import Point, Setting

SCHEMA_VERSION = 1
# verb -> the front whose configuration it takes, and which of the configuration's names it has
TAKES: dict[str, tuple[str, tuple[str, ...]]] = {
    "extract": (
        "encoders",
        ("encoder", "layer", "resolution", "frame_stride", "dtype", "runtime", "batch"),
    ),
    "train": ("encoders", ("encoder", "layer", "resolution")),
    "rollout": ("rollouts", ("integrator", "dt", "dtype", "substeps", "evaluation")),
    "render": ("drawing", ("world", "size", "antialias")),
}


@dataclass(frozen=True)
class Profile:
    """Measured points and the machine, code and versions that they were measured with."""

    surroundings: dict[str, Any]
    points: tuple[Point, ...]


def write_profile(path: Path, surroundings: dict[str, Any], points: Sequence[Point]) -> None:
    """Write a profile; see :func:`read_profile`."""
    content = {
        "schema_version": SCHEMA_VERSION,
        "kind": "vidphys profile",
        "surroundings": surroundings,
        "points": [asdict(point) for point in points],
    }
    write_json(path, content)


def read_profile(path: Path) -> Profile:
    """Read a profile.

    Raises:
        InputError: no such file, or not a profile of this version.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"--profile {path}: cannot be read ({error})") from error
    if not isinstance(content, dict) or content.get("kind") != "vidphys profile":
        raise InputError(f"--profile {path}: not a profile; `vidphys trade` writes one")
    if content.get("schema_version") != SCHEMA_VERSION:
        raise InputError(f"--profile {path}: of another version; measure it again")
    points = tuple(Point.from_dict(record) for record in content["points"])
    return Profile(content["surroundings"], points)


def profile_options(path: Path, verb: str) -> dict[str, Setting]:
    """What a verb is set to by a profile: names of its own options, with their values.

    Args:
        path: a profile with one point for the verb, as ``vidphys trade --pick`` writes it.
        verb: a key of :data:`TAKES`.

    Raises:
        InputError: the file is no profile, or has no point for this verb, or several.
    """
    front, names = TAKES[verb]
    points = [point for point in read_profile(path).points if point.front == front]
    if len(points) != 1:
        raise InputError(
            f"--profile {path}: has {len(points)} points of the front {front!r}, which {verb} is "
            'set by; choose one with `vidphys trade --pick "..." --save FILE`'
        )
    return {name: value for name, value in points[0].configuration.items() if name in names}
