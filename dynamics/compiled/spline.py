"""Trained pair potentials as splines, in plain torch: what the fast kernels are tested against.

A pair function of one or two numbers need not be evaluated by a network at every step. The spline
is built once in float64; its force is its exact gradient, so that what is rolled is still a
Hamiltonian system. Farther apart than ``reach`` the network itself is asked, pair by pair.
"""

from __future__ import annotations

import copy
import math
from abc import abstractmethod
from collections.abc import Callable
from math import comb, factorial

import torch
from torch import Tensor

from dynamics.potentials import (
    CORE,
    REACH,
    DisplacementPotential,
    PairPotential,
    RadialPotential,
    soft_length,
    unsquashed,
)


class PairSpline(PairPotential):
    """What both splines share: the network outside ``reach``, and a count of its uses.

    Args:
        network: trained; a float64 copy is made for the build.
        reach: distance in world units up to which the spline stands for the network.

    Attributes:
        resolution: how fine it is; each kind says of what.
        outside: pairs at which the network was asked, since it was last set to zero.
    """

    table: Tensor
    resolution: int

    def __init__(self, network: RadialPotential | DisplacementPotential, reach: float) -> None:
        super().__init__(network.law)
        self.network = copy.deepcopy(network).requires_grad_(False)
        self.reach, self.outside = reach, 0

    @abstractmethod
    def spline_energy(self, displacement: Tensor) -> Tensor:
        """The spline's phi within ``reach``, ``(..., d) -> (...)``."""

    @abstractmethod
    def spline_gradient(self, displacement: Tensor) -> Tensor:
        """Its exact gradient, shape of ``displacement``."""

    def pair_energy(self, displacement: Tensor) -> Tensor:
        return self._either(displacement, self.spline_energy, self.network.pair_energy)

    def pair_gradient(self, displacement: Tensor) -> Tensor:
        return self._either(displacement, self.spline_gradient, self.network.pair_gradient)

    def _either(
        self,
        displacement: Tensor,
        spline: Callable[[Tensor], Tensor],
        network: Callable[[Tensor], Tensor],
    ) -> Tensor:
        inside = soft_length(displacement).squeeze(-1) <= self.reach
        if bool(inside.all()):
            return spline(displacement)
        self.outside += int((~inside).sum())
        near = spline(displacement.where(inside.unsqueeze(-1), torch.zeros_like(displacement)))
        return near.index_put((~inside,), network(displacement[~inside]))


OCTAVES = 32  # of s that a radial spline has
OCTAVE_DEGREE = 10  # of its polynomials: fewer would save nothing that can be measured
LOWEST = -9  # power of two at which the first octave begins: the last below CORE^2
MANTISSA = {4: 23, 8: 52}  # bytes of a float -> bits of its mantissa
INTEGER = {4: torch.int32, 8: torch.int64}  # bytes of a float -> integer type of its size


class RadialSpline(PairSpline):
    """phi(s), s = r^2 + CORE^2: dphi/ds is a polynomial in each piece of s, and continuous.

    Each octave of s is cut into ``2^fineness`` pieces of equal width: the piece of an s and the
    place in it are read off its exponent and its mantissa, with no root and no division, and a
    close pair is resolved as well as a far one. phi is the integral.

    Args:
        network: trained.
        fineness: log2 of the pieces of an octave.
        reach: see :class:`PairSpline`; at most :attr:`FARTHEST`.

    Raises:
        ValueError: the reach is farther.
    """

    FARTHEST = 2.0 ** ((LOWEST + OCTAVES - 1) / 2)  # one octave is to spare
    middle: Tensor

    def __init__(self, network: RadialPotential, fineness: int, reach: float) -> None:
        super().__init__(network, reach)
        if reach > self.FARTHEST:
            raise ValueError(
                f"compile_head: a radial law is compiled up to {self.FARTHEST:.0f} world units, "
                f"not {reach:g}; ask for less, farther pairs are left to the network"
            )
        self.resolution = fineness
        exact = copy.deepcopy(network).double()
        octaves = 2.0 ** torch.arange(LOWEST, LOWEST + OCTAVES).double().unsqueeze(-1)
        width = (octaves / 2**fineness).expand(-1, 2**fineness).flatten()
        left = (octaves * (1 + torch.arange(2**fineness) / 2**fineness)).flatten()
        # Both ends are among the nodes: there, neighbours agree.
        nodes = -(torch.arange(OCTAVE_DEGREE + 1).double() * math.pi / OCTAVE_DEGREE).cos() / 2
        force = _force_per_length(exact, left + width * (nodes.unsqueeze(-1) + 0.5))
        table = torch.linalg.solve(nodes.unsqueeze(-1) ** torch.arange(OCTAVE_DEGREE + 1), force)
        # phi in the middle of each piece, counted from the network's at the far end.
        ends = left.new_tensor([[-0.5], [0.5]])
        before, after = width / 2 * horner(_integral(table.T), ends)[0]
        far = exact.distance_energy((left[-1:, None] + width[-1]).sqrt())
        middle = far - before - (after - before).flip(0).cumsum(0).flip(0)
        # Powers of the place t, from -1/2 to 1/2, in 2 dphi/ds. Floats of either size name the
        # octave that begins at 2^e by the last bits of their exponent: it is entry e - 1.
        first = (LOWEST - 1) * 2**fineness
        self.register_buffer("table", table.roll(first, 1).detach())
        self.register_buffer("middle", middle.roll(first).detach())

    def spline_energy(self, displacement: Tensor) -> Tensor:
        piece, t, width = self._place(displacement)
        return self.middle[piece] + width / 2 * horner(_integral(self.table.T[piece]), t)[0]

    def spline_gradient(self, displacement: Tensor) -> Tensor:
        piece, t, _ = self._place(displacement)
        return displacement * horner(self.table.T[piece], t)[0].unsqueeze(-1)

    def _place(self, displacement: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Piece of each pair, where in it (-1/2 to 1/2), and its width in s."""
        s = displacement.square().sum(-1) + CORE**2
        shift = MANTISSA[s.itemsize] - self.resolution
        named = s.detach().view(INTEGER[s.itemsize]) >> shift
        left, right = (x.view(s.dtype) for x in (named << shift, (named + 1) << shift))
        return named % self.table.shape[1], (s - left) / (right - left) - 0.5, right - left


def _integral(coefficients: Tensor) -> Tensor:
    """Of polynomials ``(..., powers)`` from 0 on."""
    powers = torch.arange(1, coefficients.shape[-1] + 1, device=coefficients.device)
    return torch.nn.functional.pad(coefficients / powers, (1, 0))


def _force_per_length(network: RadialPotential, s: Tensor) -> Tensor:
    """2 dphi/ds at s."""
    r = s.sqrt().unsqueeze(-1)
    return (network.slope(r) / r).squeeze(-1).detach()


DEGREE = 5  # of the plane's spline in each direction
PADDING = 32  # nodes beyond the square, over which the effect of its ends dies out


class PlaneSpline(PairSpline):
    """phi(u), u = dq / (REACH + r): a tensor spline of degree 5 through the network's values.

    The grid is uniform in the squashed u and so is graded in dq, fine where bodies are close. phi
    is even: only the half u_y >= 0 is kept, the other is looked up at -u.

    Args:
        network: trained, of displacements in a plane.
        cells: along each side of the square (-1, 1)^2 of u; even.
        reach: see :class:`PairSpline`.
    """

    def __init__(self, network: DisplacementPotential, cells: int, reach: float) -> None:
        super().__init__(network, reach)
        self.resolution = cells
        coefficients = plane_coefficients(network, cells)
        size, half = DEGREE + 1, cells // 2
        blocks = coefficients.unfold(0, size, 1).unfold(1, size, 1)
        basis = segment_basis(DEGREE)
        polynomials = basis @ blocks[:, half:] @ basis.T
        # Coefficient of s^i t^j of cell (x, y), the powers of t side by side.
        self.register_buffer("table", polynomials.reshape(cells * half, size * size))

    def spline_energy(self, displacement: Tensor) -> Tensor:
        table, s, t, _ = self._cells(displacement / (REACH + soft_length(displacement)))
        return value_at(value_at(table, t), s.squeeze(-1))

    def spline_gradient(self, displacement: Tensor) -> Tensor:
        r = soft_length(displacement)
        table, s, t, sign = self._cells(displacement / (REACH + r))
        rows, slopes = horner(table, t)
        s = s.squeeze(-1)
        slope = torch.stack([horner(rows, s)[1], value_at(slopes, s)], -1)
        return unsquashed(slope * (sign * self.resolution / 2), displacement, r)

    def _cells(self, u: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Polynomials in t for each power of s ``(..., 6, 6)``, s and t, and the sign of u."""
        sign = torch.where(u[..., 1:] < 0, -1, 1).to(u.dtype)
        at = u * sign * (self.resolution / 2)
        corner = at.detach().floor()
        x, y = corner.long().unbind(-1)
        half = self.resolution // 2
        s, t = (at - corner).split(1, -1)
        table = self.table[(x + half) * half + y].unflatten(-1, (DEGREE + 1, DEGREE + 1))
        return table, s, t, sign


def plane_coefficients(network: DisplacementPotential, cells: int) -> Tensor:
    """Of the B-splines that reach into the square, ``(cells + 5, cells + 5)``, in float64.

    Cell (x, y), counted from the corner (-1, -1), is made by those from (x, y) to (x + 5, y + 5).
    """
    near = slice(PADDING - 2, PADDING - 2 + cells + DEGREE)
    return _interpolated(copy.deepcopy(network).double(), cells)[near, near]


def _interpolated(network: DisplacementPotential, cells: int) -> Tensor:
    """Coefficients of the spline through phi at the nodes of the padded square, one a node."""
    axis = torch.arange(-PADDING, cells + PADDING + 1, dtype=torch.float64) * 2 / cells - 1
    rows = [network.disk_energy(torch.stack([x.expand_as(axis), axis], -1)).detach() for x in axis]
    weights = segment_basis(DEGREE)[0, :DEGREE]
    matrix = sum(
        torch.diag(w.expand(len(axis) - abs(k)), k)
        for k, w in zip(range(-2, 3), weights, strict=True)
    )
    return torch.linalg.solve(matrix, torch.linalg.solve(matrix, torch.stack(rows)).T).T


def segment_basis(degree: int) -> Tensor:
    """Cardinal B-splines on one cell: ``[k, m]`` is the factor of t^k in the m-th of them."""

    def entry(k: int, m: int) -> float:
        terms = (
            (-1) ** j * comb(degree + 1, j) * comb(degree, k) * (degree - m - j) ** (degree - k)
            for j in range(degree - m + 1)
        )
        return sum(terms) / factorial(degree)

    size = range(degree + 1)
    return torch.tensor([[entry(k, m) for m in size] for k in size], dtype=torch.float64)


def horner(coefficients: Tensor, t: Tensor) -> tuple[Tensor, Tensor]:
    """A polynomial ``(..., powers)`` and its derivative at t."""
    value = slope = torch.zeros_like(t)
    for factor in reversed(coefficients.unbind(-1)):
        value, slope = value * t + factor, slope * t + value
    return value, slope


def value_at(coefficients: Tensor, t: Tensor) -> Tensor:
    """A polynomial ``(..., powers)`` at t."""
    value = torch.zeros_like(t)
    for factor in reversed(coefficients.unbind(-1)):
        value = value * t + factor
    return value
