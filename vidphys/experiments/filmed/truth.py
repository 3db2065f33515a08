"""The truth of a filmed clip, as it lies beside it in JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from vidphys.experiments.filmed.scenes.scene import Number
from vidphys.runs.atomic import write_json

SCHEMA_VERSION = 1
DIGITS = 4  # of a pixel


@dataclass(frozen=True)
class Ruler:
    """A known length in the picture.

    Args:
        metres: between its ends.
        pixels: its ends, ``(2, 2)``, as the first frame shows them.
    """

    metres: float
    pixels: np.ndarray


@dataclass(frozen=True)
class Truth:
    """What is known of a clip.

    Pixels are (column, row), counted from the centre of the upper left one.

    Args:
        kind: of the scene.
        part: of the set.
        seed, number: of the clip.
        size: (height, width), pixels.
        structure: the kinds of terms that a right answer names, sorted.
        numbers: with units.
        stamps: seconds, as the container tells them, ``(t,)``.
        times: seconds at which the frames were taken, ``(t,)``.
        shown: for each frame the one whose picture it shows; another one where it is doubled.
        pixels: of the bodies' centres in the pictures, ``(t, n, 2)``.
        steady: the same for a camera that stays as it was in the first frame.
        radii: of the bodies in the first picture, pixels, ``(n,)``.
        metres: places in the plane of motion, ``(t, n, 2)``.
        released: seconds from which the law holds.
        ruler: see :class:`Ruler`.
        view: of the plane of motion: ``(3, 3)`` takes (x, y, 1) in metres to homogeneous pixels of
            the first frame, but for the lens.
        values: of the law, by name.
        nuisances: of the camera.
    """

    kind: str
    part: str
    seed: int
    number: int
    size: tuple[int, int]
    structure: tuple[str, ...]
    numbers: tuple[Number, ...]
    stamps: np.ndarray
    times: np.ndarray
    shown: np.ndarray
    pixels: np.ndarray
    steady: np.ndarray
    radii: np.ndarray
    metres: np.ndarray
    released: float
    ruler: Ruler
    view: np.ndarray
    values: dict[str, float]
    nuisances: dict[str, Any]

    def write(self, path: Path) -> None:
        """As JSON, whole or not at all."""
        data = {name: getattr(self, name) for name in self.__dataclass_fields__}
        data["numbers"] = [asdict(number) for number in self.numbers]
        data["ruler"] = {"metres": self.ruler.metres, "pixels": self.ruler.pixels.tolist()}
        for name in ("pixels", "steady", "radii"):
            data[name] = np.round(data[name], DIGITS).tolist()
        for name in ("stamps", "times", "metres"):
            data[name] = np.round(data[name], 7).tolist()
        data["shown"], data["view"] = self.shown.tolist(), self.view.tolist()
        write_json(path, {"schema_version": SCHEMA_VERSION, **data})

    @classmethod
    def read(cls, path: Path) -> Self:
        """From JSON."""
        data = json.loads(path.read_text(encoding="utf-8"))
        data.pop("schema_version")
        for name in ("stamps", "times", "shown", "pixels", "steady", "radii", "metres", "view"):
            data[name] = np.array(data[name])
        data["numbers"] = tuple(Number(**number) for number in data["numbers"])
        data["ruler"] = Ruler(data["ruler"]["metres"], np.array(data["ruler"]["pixels"]))
        for name in ("size", "structure"):
            data[name] = tuple(data[name])
        return cls(**data)
