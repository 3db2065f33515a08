"""Curves in the picture, and the coordinates of bodies that are bound to them.

A curve takes coordinates s ``(..., n, 1)`` to places ``(..., n, d)``. Beside the place it gives how
a rate of s looks in the picture, and both ways back; a place beside the curve is taken to where it
would be on it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from torch import Tensor, nn

FINE = 64  # points of a drawn curve's table for each one given
POLISHED = 4  # Newton steps to the nearest point


class Curve(nn.Module, ABC):
    """Where the bodies of a model may be."""

    @abstractmethod
    def place(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b n d"]:
        """The place of a coordinate."""

    @abstractmethod
    def coordinate(self, q: Float[Tensor, "*b n d"]) -> Float[Tensor, "*b n 1"]:
        """The coordinate of a place."""

    @abstractmethod
    def velocity(
        self, s: Float[Tensor, "*b n 1"], rate: Float[Tensor, "*b n 1"]
    ) -> Float[Tensor, "*b n d"]:
        """How bodies move in the picture whose coordinates change at these rates."""

    @abstractmethod
    def rate(
        self, s: Float[Tensor, "*b n 1"], velocity: Float[Tensor, "*b n d"]
    ) -> Float[Tensor, "*b n 1"]:
        """Inverse of :meth:`velocity`; what does not go along the curve is dropped."""

    @abstractmethod
    def pull(
        self, s: Float[Tensor, "*b n 1"], force: Float[Tensor, "*b n 1"]
    ) -> Float[Tensor, "*b n d"]:
        """The force in the picture that does the same work as one on the coordinates."""


class TangentCurve(Curve):
    """A curve that every body has for itself; subclasses give its tangent dq/ds."""

    @abstractmethod
    def tangent(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b n d"]:
        """dq/ds."""

    def cotangent(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b n d"]:
        """ds/dq: its product with the tangent is one."""
        tangent = self.tangent(s)
        return tangent / tangent.square().sum(-1, keepdim=True)

    def velocity(self, s: Tensor, rate: Tensor) -> Tensor:
        return self.tangent(s) * rate

    def rate(self, s: Tensor, velocity: Tensor) -> Tensor:
        return (self.cotangent(s) * velocity).sum(-1, keepdim=True)

    def pull(self, s: Tensor, force: Tensor) -> Tensor:
        return self.cotangent(s) * force


class ByLength(TangentCurve):
    """A curve whose coordinate is the way along it, so that its tangent has length one."""

    @abstractmethod
    def bend(self, s: Float[Tensor, "*b n 1"]) -> Float[Tensor, "*b n d"]:
        """d^2q/ds^2, towards the centre of the circle that fits best, of its curvature's length."""

    @property
    @abstractmethod
    def sharpest(self) -> float:
        """The largest curvature, over world units."""


class Line(ByLength):
    """A straight rail; s is the way along it from ``point``, in world units.

    Args:
        point: on the line, ``(d,)``.
        direction: of growing s, ``(d,)``, of any length above zero.

    Raises:
        ValueError: a direction of no length.
    """

    point: Tensor
    along: Tensor

    def __init__(self, point: Sequence[float], direction: Sequence[float]) -> None:
        super().__init__()
        along = torch.tensor(direction, dtype=torch.float64)
        if not float(along.norm()) > 0:
            raise ValueError(f"Line: the direction must point somewhere, got {tuple(direction)}")
        self.register_buffer("point", torch.tensor(point, dtype=torch.float64))
        self.register_buffer("along", along / along.norm())

    def place(self, s: Tensor) -> Tensor:
        return self.point.to(s) + s * self.along.to(s)

    def tangent(self, s: Tensor) -> Tensor:
        return self.along.to(s).expand(*s.shape[:-1], -1)

    def bend(self, s: Tensor) -> Tensor:
        return torch.zeros_like(self.tangent(s))

    @property
    def sharpest(self) -> float:
        return 0.0

    def coordinate(self, q: Tensor) -> Tensor:
        return ((q - self.point.to(q)) * self.along.to(q)).sum(-1, keepdim=True)


class Arc(TangentCurve):
    """A circle as a camera sees it: place = pivot + across sin s + down cos s, s in radians.

    The two vectors are of one length and at right angles where the camera looks straight; a tilted
    one sees an ellipse, in which any two that are not parallel may be.

    Args:
        pivot: the centre, ``(d,)``.
        across: from it to where s is a quarter turn, ``(d,)``.
        down: from it to where s = 0, ``(d,)``.

    Raises:
        ValueError: vectors that span no plane: from the edge an angle is not seen.
    """

    pivot: Tensor
    frame: Tensor

    def __init__(
        self, pivot: Sequence[float], across: Sequence[float], down: Sequence[float]
    ) -> None:
        super().__init__()
        frame = torch.tensor([across, down], dtype=torch.float64)
        if int(torch.linalg.matrix_rank(frame)) < 2:
            raise ValueError(
                f"Arc: `across` {tuple(across)} and `down` {tuple(down)} must span a plane"
            )
        self.register_buffer("pivot", torch.tensor(pivot, dtype=torch.float64))
        self.register_buffer("frame", frame)

    def place(self, s: Tensor) -> Tensor:
        return self.pivot.to(s) + torch.cat([s.sin(), s.cos()], -1) @ self.frame.to(s)

    def tangent(self, s: Tensor) -> Tensor:
        return torch.cat([s.cos(), -s.sin()], -1) @ self.frame.to(s)

    def cotangent(self, s: Tensor) -> Tensor:
        return torch.cat([s.cos(), -s.sin()], -1) @ self.inverse.to(s).mT

    def coordinate(self, q: Tensor) -> Tensor:
        sine, cosine = ((q - self.pivot.to(q)) @ self.inverse.to(q)).split(1, -1)
        return torch.atan2(sine, cosine)

    @property
    def inverse(self) -> Tensor:
        """From places to (sin s, cos s), ``(d, 2)``."""
        return torch.linalg.pinv(self.frame)


class Drawn(ByLength):
    """A smooth curve through points; s is the way along it from the first, in world units.

    It is closed where the last point is the first, and goes on straight beyond its ends otherwise.
    A place belongs to the nearest point, so that a curve may come near itself only where no body is
    asked about by its place.

    Args:
        points: ``(k, d)``, at least three.

    Raises:
        ValueError: fewer, or neighbours that coincide.
    """

    ways: Tensor
    pieces: Tensor

    def __init__(self, points: Sequence[Sequence[float]]) -> None:
        super().__init__()
        given = np.asarray(points, float)
        steps = np.linalg.norm(np.diff(given, axis=0), axis=-1)
        if len(given) < 3 or not (steps > 0).all():
            raise ValueError("Drawn: a curve needs three points or more, no two in a row the same")
        self.closed = bool((given[0] == given[-1]).all())
        ends = "periodic" if self.closed else "natural"
        rough = np.concatenate([[0.0], steps.cumsum()])
        drawn = CubicSpline(rough, given, bc_type=ends)
        # again by the way along it, which the chords between the points only come near to
        fine = np.interp(np.arange(FINE * len(steps) + 1) / FINE, np.arange(len(rough)), rough)
        nodes, weights = np.polynomial.legendre.leggauss(5)
        middle, half = (fine[1:] + fine[:-1]) / 2, np.diff(fine) / 2
        speed = np.linalg.norm(drawn(middle[:, None] + half[:, None] * nodes, 1), axis=-1)
        ways = np.concatenate([[0.0], (half * (speed @ weights)).cumsum()])
        places = drawn(fine)
        places[-1] = places[0] if self.closed else places[-1]
        pieces = CubicSpline(ways, places, bc_type=ends).c[::-1]  # (power, piece, d)
        self.register_buffer("ways", torch.tensor(ways))
        self.register_buffer("pieces", torch.tensor(pieces.copy()))

    @property
    def length(self) -> float:
        """World units from end to end."""
        return float(self.ways[-1])

    def place(self, s: Tensor) -> Tensor:
        inside, beyond = self._inside(s)
        a, b, c, d, x = self._piece(inside)
        return a + x * (b + x * (c + x * d)) + beyond * self.tangent(inside)

    def tangent(self, s: Tensor) -> Tensor:
        _, b, c, d, x = self._piece(self._inside(s)[0])
        return b + x * (2 * c + 3 * x * d)

    def bend(self, s: Tensor) -> Tensor:
        inside, beyond = self._inside(s)
        _, _, c, d, x = self._piece(inside)
        return torch.where(beyond == 0, 2 * c + 6 * x * d, 0)

    @property
    def sharpest(self) -> float:
        return float(2 * self.pieces[2].norm(dim=-1).max())

    def velocity(self, s: Tensor, rate: Tensor) -> Tensor:
        return self._ahead(s) * rate

    def rate(self, s: Tensor, velocity: Tensor) -> Tensor:
        return (self._ahead(s) * velocity).sum(-1, keepdim=True)

    def _ahead(self, s: Tensor) -> Tensor:
        """The tangent, whose length is one but for the spline's error, at exactly that."""
        return nn.functional.normalize(self.tangent(s), dim=-1)

    def coordinate(self, q: Tensor) -> Tensor:
        table = self.pieces[0].to(q)
        away = (q.detach().unsqueeze(-2) - table).square().sum(-1)
        s = self.ways[:-1].to(q)[away.argmin(-1)].unsqueeze(-1)
        for _ in range(POLISHED):
            s = self._nearer(q.detach(), s)
        return self._nearer(q, s.detach())

    def _nearer(self, q: Tensor, s: Tensor) -> Tensor:
        tangent, off, bend = self.tangent(s), q - self.place(s), self.bend(s)
        along = (off * tangent).sum(-1, keepdim=True)
        return s + along / (tangent.square() - off * bend).sum(-1, keepdim=True)

    def _inside(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """The coordinate on the curve, and how far beyond its ends."""
        if self.closed:
            return s % self.length, torch.zeros_like(s)
        inside = s.clamp(0, self.length)
        return inside, s - inside

    def _piece(self, s: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Four coefficients ``(..., n, d)``, and the way since the piece began."""
        ways, last = self.ways.to(s), len(self.ways) - 2
        index = (torch.bucketize(s.detach().contiguous(), ways, right=True) - 1).clamp(0, last)
        a, b, c, d = self.pieces.to(s)[:, index.squeeze(-1)]
        return a, b, c, d, s - ways[index]


class Chain(Curve):
    """Rods end on end, each at an angle s (radians) from hanging straight down.

    place_k = place_{k-1} + length_k (across sin s_k + down cos s_k), from the pivot on.

    Args:
        pivot, across, down: see :class:`Arc`; world units for each unit of length.
        lengths: of the rods, one for each body.

    Raises:
        ValueError: see :class:`Arc`.
    """

    lengths: Tensor

    def __init__(
        self,
        pivot: Sequence[float],
        across: Sequence[float],
        down: Sequence[float],
        lengths: Sequence[float],
    ) -> None:
        super().__init__()
        self.arc = Arc(pivot, across, down)
        self.register_buffer("lengths", torch.tensor(lengths, dtype=torch.float64)[:, None])

    def place(self, s: Tensor) -> Tensor:
        pivot = self.arc.pivot.to(s)
        return pivot + (self.lengths.to(s) * (self.arc.place(s) - pivot)).cumsum(-2)

    def coordinate(self, q: Tensor) -> Tensor:
        pivot = self.arc.pivot.to(q)
        return self.arc.coordinate(pivot + self._apart(q - pivot) / self.lengths.to(q))

    def velocity(self, s: Tensor, rate: Tensor) -> Tensor:
        return (self.lengths.to(s) * self.arc.velocity(s, rate)).cumsum(-2)

    def rate(self, s: Tensor, velocity: Tensor) -> Tensor:
        return self.arc.rate(s, self._apart(velocity) / self.lengths.to(s))

    def pull(self, s: Tensor, force: Tensor) -> Tensor:
        own = self.arc.pull(s, force) / self.lengths.to(s)
        return own - torch.cat([own[..., 1:, :], torch.zeros_like(own[..., :1, :])], -2)

    @staticmethod
    def _apart(x: Tensor) -> Tensor:
        """Of each body, from the one before it."""
        return torch.cat([x[..., :1, :], x[..., 1:, :] - x[..., :-1, :]], -2)
