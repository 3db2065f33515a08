"""What is known of one clip: places and columns by frame, from which targets are made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Truth:
    """Places and columns of one clip, a row for each frame.

    Args:
        times: seconds of each frame, ``(t,)``.
        columns: by name, ``(t,)`` each: numbers (NaN where not known) or words. Of body 1, 2, ...
            they are called as in :func:`vidphys.data.rendered.truth_of`: ``vx1``, ``vy2``, ``m3``.
        places: of the bodies, ``(t, n, 2)``, world units; NaN where one was not seen. ``None``
            where they are not known.
        why_not: why not.
    """

    times: np.ndarray
    columns: Mapping[str, np.ndarray]
    places: np.ndarray | None = None
    why_not: str = "nothing tells where the bodies are"

    def column(self, name: str) -> np.ndarray:
        """One column, ``(t,)``.

        Raises:
            ValueError: there is none of this name.
        """
        if name not in self.columns:
            raise ValueError(f"no column {name}; there are {', '.join(self.columns) or 'none'}")
        return self.columns[name]

    def positions(self) -> np.ndarray:
        """``(t, n, 2)``, world units.

        Raises:
            ValueError: they are not known.
        """
        if self.places is None:
            raise ValueError(self.why_not)
        return self.places

    def has(self, *stems: str) -> bool:
        """Whether there are columns of each stem, for as many bodies as have places."""
        bodies = {self._bodies(stem) for stem in stems}
        return min(bodies) > 0 and (self.places is None or bodies == {self.places.shape[1]})

    def of_bodies(self, *stems: str) -> np.ndarray:
        """Columns of every body, ``(t, n, stems)``.

        Args:
            stems: names without the number of the body, such as ``vx`` and ``vy``.

        Raises:
            ValueError: a body's column is missing, or there are not as many as bodies with places.

        Example:
            >>> speeds = {"vx1": np.array([0.0, 1.0]), "vx2": np.array([2.0, 3.0])}
            >>> truth = Truth(np.arange(2.0), speeds)
            >>> truth.of_bodies("vx").tolist()
            [[[0.0], [2.0]], [[1.0], [3.0]]]
        """
        count = self._bodies(stems[0])
        if not count:
            raise ValueError(f"no column {stems[0]}1")
        if self.places is not None and count != self.places.shape[1]:
            raise ValueError(
                f"columns {stems[0]} of {count} bodies, places of {self.places.shape[1]}"
            )
        return np.stack(
            [
                np.stack([self.column(f"{stem}{n + 1}").astype(float) for stem in stems], -1)
                for n in range(count)
            ],
            1,
        )

    def _bodies(self, stem: str) -> int:
        """How many have a column of this stem."""
        count = 0
        while f"{stem}{count + 1}" in self.columns:
            count += 1
        return count


@dataclass(frozen=True)
class Track:
    """Where the bodies of several clips are, those of a clip together and in order of time.

    Args:
        positions: ``(e, n, 2)``, world units; NaN where not known.
        times: seconds, ``(e,)``.
        clips: number of the clip, ``(e,)``.
    """

    positions: np.ndarray
    times: np.ndarray
    clips: np.ndarray
