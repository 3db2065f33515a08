"""The truth of a filmed clip, as it lies beside it in JSON."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, JsonValue, model_validator

from vidphys import boundary
from vidphys.boundary import Above, Closed, Word, read_json
from vidphys.experiments.filmed.scenes.scene import Number
from vidphys.runs.atomic import write_json

SCHEMA_VERSION = 1
DIGITS = 4  # of a pixel

Count = Annotated[int, Field(ge=0, lt=2**63)]
Row = tuple[boundary.Number, ...]
Place = tuple[boundary.Number, boundary.Number]
Places = tuple[tuple[Place, ...], ...]
Homogeneous = tuple[boundary.Number, boundary.Number, boundary.Number]


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
        radii: of the bodies with all their parts, in the first picture, pixels, ``(n,)``.
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
        """From JSON.

        Raises:
            InputError: not the truth of a clip; the field that is wrong is named.
        """
        held = read_json(path, TruthFile, "the truth of a clip")
        data = {name: getattr(held, name) for name in cls.__dataclass_fields__}
        for name in ("stamps", "times", "shown", "pixels", "steady", "radii", "metres", "view"):
            data[name] = np.array(data[name])
        data["numbers"] = tuple(Number(**each.model_dump()) for each in held.numbers)
        data["ruler"] = Ruler(held.ruler.metres, np.array(held.ruler.pixels))
        return cls(**data)


class NumberFile(Closed):
    """See :class:`Number`."""

    name: Word
    value: boundary.Number
    unit: Word
    body: Count | None = None


class RulerFile(Closed):
    """See :class:`Ruler`."""

    metres: Above
    pixels: tuple[Place, Place]


class TruthFile(Closed):
    """What ``truth.json`` holds; see :class:`Truth`."""

    schema_version: Literal[1]
    kind: Word
    part: Word
    seed: Count
    number: Count
    size: tuple[Count, Count]
    structure: tuple[Word, ...]
    numbers: tuple[NumberFile, ...]
    stamps: Row
    times: Row
    shown: tuple[Count, ...]
    pixels: Places
    steady: Places
    radii: Row
    metres: Places
    released: boundary.Number
    ruler: RulerFile
    view: tuple[Homogeneous, Homogeneous, Homogeneous]
    values: dict[Word, boundary.Number]
    nuisances: dict[str, JsonValue]

    @model_validator(mode="after")
    def _fits(self) -> Self:
        frames, bodies = len(self.stamps), len(self.radii)
        for name in ("times", "shown", "pixels", "steady", "metres"):
            if len(getattr(self, name)) != frames:
                raise ValueError(f"{name}: is of {len(getattr(self, name))} frames, not {frames}")
        for name in ("pixels", "steady", "metres"):
            if any(len(row) != bodies for row in getattr(self, name)):
                raise ValueError(f"{name}: is not of {bodies} bodies in every frame")
        return self
