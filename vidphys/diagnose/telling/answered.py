"""All that is told of one recording, and what is drawn of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vidphys.data.frames import Frames
from vidphys.diagnose.diagnosis import Diagnosis
from vidphys.diagnose.recordings.units import Units


@dataclass(frozen=True)
class Answered:
    """A diagnosis with all that is written of it.

    Args:
        found: the diagnosis, of the part before the tail that is held out.
        lines: for a person.
        data: as JSON.
        specification: of the scene, where there is one.
        numbers: for the records, by metric.
        times, positions: of the longest clip, all of it.
        probability: of each term.
        rolled: times and positions past the fitted part, ``model`` and changed laws.
        path: times and positions of the model over all frames, where it has such.
        told_in: in which lengths are told.
    """

    found: Diagnosis
    lines: list[str]
    data: dict[str, Any]
    specification: dict[str, Any] | None
    numbers: dict[str, float]
    times: np.ndarray
    positions: np.ndarray
    probability: dict[str, float] = field(default_factory=dict)
    rolled: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    path: tuple[np.ndarray, np.ndarray] | None = None
    told_in: Units = field(default_factory=Units)

    @property
    def stays(self) -> bool:
        """Whether what is foretold is that the bodies stay where they are."""
        return bool(self.data.get("stays", False))

    @property
    def headline(self) -> list[str]:
        """The verdict and the law, and which frames are used."""
        used, *told = self.lines
        return [*[line for line in told if not line.startswith(" ")][:2], used]

    @property
    def law(self) -> str:
        """The changed law that is drawn, in words; empty where none is."""
        return next((name for name in self.rolled if name != "model"), "")

    def showcase(self, frames: Frames | None) -> dict[str, Any] | None:
        """Arrays of the recording; ``None`` where there is no plane to draw, or no forecast.

        Without ``frames`` of a clip, they have none either.
        """
        if self.positions.shape[-1] > 2 or "model" not in self.rolled:
            return None
        when, path = self.rolled["model"]
        extent = float(np.nanmax(np.abs(self.positions))) * 1.1
        if frames is not None:
            extent = 1.0  # normalised image units
        arrays: dict[str, Any] = {
            **({} if frames is None else {"frames": frames}),
            "frame_times": self.times,
            "readout": self.shown(_plane(self.positions)),
            "rollout": self.shown(_plane(path)),
            "rollout_times": when,
            "half_extent": np.asarray(extent),
            "train_end": np.asarray(when[0]),
        }
        if self.law:
            when, path = self.rolled[self.law]
            arrays |= {"changed_times": when, "changed": self.shown(_plane(path))}
        return arrays

    def shown(self, places: np.ndarray) -> np.ndarray:
        """Places ``(…, 2)`` as the clip's picture shows them."""
        plane = self.told_in.plane
        return places if plane is None else plane.shown(places)


def _plane(positions: np.ndarray) -> np.ndarray:
    """Positions of one dimension drawn on the horizontal axis."""
    if positions.shape[-1] == 2:
        return positions
    return np.concatenate([positions, np.zeros_like(positions)], -1)
