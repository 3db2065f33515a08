"""The compact file that a choice travels in: measured points, and where they were measured.

``vidphys trade`` writes one with the points of all fronts; a pick writes one with what was chosen,
and a verb takes its options from that one as its profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from vidphys.errors import InputError
from vidphys.points.point import Point, Setting
from vidphys.runs.sealed import read_sealed, write_sealed

SCHEMA, UNSEALED = 2, 1  # the latter had no hash of itself
Config = TypeVar("Config")
_LOOK = ("encoder", "layer", "resolution", "frame_stride", "dtype")
# verb -> the fronts whose configuration it takes, and which of the configuration's names it has
TAKES: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "extract": (("encoders", "runtimes"), (*_LOOK, "runtime", "batch", "store_dtype", "grid")),
    "train": (("encoders",), _LOOK),
    "render": (("drawing",), ("world", "image")),
}


@dataclass(frozen=True)
class Profile:
    """Measured points and the machine, code and versions that they were measured with."""

    surroundings: dict[str, Any]
    points: tuple[Point, ...]


def write_profile(path: Path, surroundings: dict[str, Any], points: Sequence[Point]) -> None:
    """Write a profile; see :func:`read_profile`."""
    content = {
        "kind": "vidphys profile",
        "surroundings": surroundings,
        "points": [asdict(point) for point in points],
    }
    write_sealed(path, content, SCHEMA)


def read_profile(path: Path) -> Profile:
    """Read a profile.

    Raises:
        InputError: no such file, or not a profile of this version.
    """
    content = read_sealed(path, "a profile", "`vidphys trade` writes one", SCHEMA, (), UNSEALED)
    if content.get("kind") != "vidphys profile":
        raise InputError(f"{path}: not a profile; `vidphys trade` writes one")
    points = tuple(Point.from_dict(record) for record in content["points"])
    return Profile(content["surroundings"], points)


def profile_options(path: Path, verb: str) -> dict[str, Setting]:
    """What a verb is set to by a profile: names of its own options, with their values.

    Args:
        path: a profile with one point for the verb, as ``vidphys trade`` saves a picked one.
        verb: a key of :data:`TAKES`.

    Raises:
        InputError: the file is no profile, or has no point for this verb, or several.
    """
    fronts, names = TAKES[verb]
    points = [point for point in read_profile(path).points if point.front in fronts]
    if len(points) != 1:
        raise InputError(
            f"`profile` {path}: has {len(points)} points of what {verb} is set by "
            f"({', '.join(fronts)}); pick one, and save that"
        )
    return {name: value for name, value in points[0].configuration.items() if name in names}


def under_profile(config: Config, path: Path | None, verb: str) -> Config:
    """A verb's configuration with what a profile says.

    Args:
        config: a frozen dataclass; what it was given besides the profile must not differ from it.
        path: of the profile; ``None`` changes nothing.
        verb: a key of :data:`TAKES`.

    Raises:
        InputError: see :func:`profile_options`; or an option is given that the profile has
            otherwise.
    """
    if path is None:
        return config
    usual = {f.name: f.default for f in fields(config)}  # type: ignore[arg-type]
    chosen: dict[str, Any] = profile_options(path, verb)
    for name in [name for name in chosen if name not in usual]:  # a verb that takes several
        chosen[f"{name}s"] = (chosen.pop(name),)
    for name, value in chosen.items():
        given = getattr(config, name)
        if given not in (usual[name], value):
            raise InputError(
                f"{verb}: `profile` {path} has {name} {value}, and `{name}` {given} is given as "
                "well; leave one of them away"
            )
    return replace(config, **chosen)  # type: ignore[type-var]
