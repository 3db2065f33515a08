"""Coordinates for what moves in a picture: places in the plane, or one along a curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from vidphys.errors import InputError

BEND = 3  # degree of a curve's polynomial
THIN = 0.1  # a path whose offset from the curve is a smaller share of its spread is a curve


@dataclass(frozen=True)
class Plane:
    """Positions as they are, in world units."""

    kind: ClassVar[str] = "plane"
    space: ClassVar[int] = 2

    def coordinate(self, positions: Tensor) -> Tensor:
        """``(..., 2)`` to ``(..., 2)``."""
        return positions.double()

    def place(self, coordinate: Tensor) -> Tensor:
        """Inverse of :meth:`coordinate`."""
        return coordinate.double()

    def to_config(self) -> dict[str, Any]:
        """Plain data for :func:`chart_from_config`."""
        return {"kind": self.kind}


@dataclass(frozen=True)
class Curve:
    """A smooth curve in the picture, and the coordinate along it (unit: its spread in training).

    Args:
        centre, axis: of the principal direction, ``(2,)`` each, world units.
        scale: world units of one coordinate unit.
        bend: polynomial of the offset across the axis, highest power first.
    """

    kind: ClassVar[str] = "curve"
    space: ClassVar[int] = 1
    centre: np.ndarray
    axis: np.ndarray
    scale: float
    bend: np.ndarray

    @classmethod
    def through(cls, positions: Tensor) -> Curve:
        """Fit the curve to positions ``(t, 2)``.

        Raises:
            InputError: they do not differ.
        """
        points = positions.double().numpy()
        centre = points.mean(0)
        axis = np.linalg.svd(points - centre, full_matrices=False)[2][0]
        along = (points - centre) @ axis
        scale = float(along.std())
        if not scale > 0:
            raise InputError("train: the body does not move in the training part of the clip")
        bend = np.polyfit(along / scale, (points - centre) @ _across(axis), BEND)
        return cls(centre, axis, scale, bend)

    def coordinate(self, positions: Tensor) -> Tensor:
        """``(..., 2)`` world units to ``(..., 1)``."""
        along = (positions.double().numpy() - self.centre) @ self.axis / self.scale
        return torch.from_numpy(along).unsqueeze(-1)

    def place(self, coordinate: Tensor) -> Tensor:
        """Inverse of :meth:`coordinate` on the curve, ``(..., 1)`` to ``(..., 2)``."""
        s = coordinate.double().numpy()
        offset = np.polyval(self.bend, s)
        return torch.from_numpy(
            self.centre + self.scale * s * self.axis + offset * _across(self.axis)
        )

    def to_config(self) -> dict[str, Any]:
        """Plain data for :func:`chart_from_config`."""
        lists = {name: getattr(self, name).tolist() for name in ("centre", "axis", "bend")}
        return {"kind": self.kind, "scale": self.scale, **lists}


Chart = Plane | Curve


def chart_of(positions: Tensor) -> Chart:
    """What positions ``(t, n, 2)`` need: one body that keeps to a curve needs no more than that.

    Raises:
        InputError: a single body that does not move.
    """
    if positions.shape[1] != 1:
        return Plane()
    curve = Curve.through(positions[:, 0])
    missed = curve.place(curve.coordinate(positions)) - positions
    rms = float(missed.square().sum(-1).mean().sqrt())
    return curve if rms < THIN * curve.scale else Plane()


def chart_from_config(config: dict[str, Any]) -> Chart:
    """Inverse of ``to_config``, also after a way through JSON."""
    if config["kind"] == Plane.kind:
        return Plane()
    arrays = {name: np.array(config[name]) for name in ("centre", "axis", "bend")}
    return Curve(scale=config["scale"], **arrays)


def _across(axis: np.ndarray) -> np.ndarray:
    return np.array([-axis[1], axis[0]])
