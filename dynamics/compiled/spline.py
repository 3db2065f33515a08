"""Trained pair potentials as splines, in plain torch: what the fast kernels are tested against.

A pair function of one or two numbers need not be evaluated by a network at every step. The spline
is built once in float64; its force is its exact gradient, so that what is rolled is still a
Hamiltonian system. Farther apart than ``reach`` the network itself is asked, pair by pair.
"""

from __future__ import annotations

import copy
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
    def lookup(self, dtype: torch.dtype) -> tuple[int, int]:
        """Two numbers by which a kernel of this float type finds a cell; each kind says which."""

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


# float type -> (integer type of the same size, bits of the mantissa)
BITS = {torch.float32: (torch.int32, 23), torch.float64: (torch.int64, 52)}


class RadialSpline(PairSpline):
    """phi(s), s = r^2 + CORE^2: dphi/ds is a cubic Hermite spline, its values and slopes exact.

    Each octave of s is cut into ``2^fineness`` cells of equal width: the cell of an s is read off
    its exponent and its first bits, with no root and no division, and short distances have as many
    cells as long ones. phi is that spline's integral, of degree four and twice differentiable.

    Args:
        network: trained.
        fineness: log2 of the cells of an octave.
        reach: see :class:`PairSpline`.
    """

    offset: Tensor

    def __init__(self, network: RadialPotential, fineness: int, reach: float) -> None:
        super().__init__(network, reach)
        self.resolution = fineness
        ends = torch.tensor([CORE**2, reach**2], dtype=torch.float64).view(torch.int64)
        first, last = (ends >> (52 - fineness)).tolist()
        knots = (torch.arange(first, last + 2) << (52 - fineness)).view(torch.float64)
        force, slope = _force_per_length(copy.deepcopy(network).double(), knots)
        width = knots.diff()
        table = _hermite(force, slope, width)
        # phi of each cell's left end, counted from the network's phi at the far end.
        grown = (table / torch.arange(1, 5)).sum(-1) * width / 2
        far = copy.deepcopy(network).double().distance_energy(knots[-1:].sqrt())
        left = far - grown.flip(0).cumsum(0).flip(0)
        # Of 2 dphi/ds, by powers of the place in the cell.
        self.register_buffer("table", table.detach())
        self.register_buffer("offset", left.detach())

    def lookup(self, dtype: torch.dtype) -> tuple[int, int]:
        """Bits of s below those that name its cell, and the name of the first cell."""
        integer, mantissa = BITS[dtype]
        shift = mantissa - self.resolution
        return shift, int(torch.tensor(CORE**2, dtype=dtype).view(integer)) >> shift

    def spline_energy(self, displacement: Tensor) -> Tensor:
        cell, t, width = self._place(displacement)
        area = horner(self.table[cell] / torch.arange(1, 5), t)[0] * t
        return self.offset[cell] + area * width / 2

    def spline_gradient(self, displacement: Tensor) -> Tensor:
        cell, t, _ = self._place(displacement)
        return displacement * horner(self.table[cell], t)[0].unsqueeze(-1)

    def _place(self, displacement: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Cell of each pair, where in it (0 to 1), and the cell's width in s."""
        s = displacement.square().sum(-1) + CORE**2
        shift, first = self.lookup(s.dtype)
        bits = s.detach().view(BITS[s.dtype][0]) >> shift
        left, right = (x.view(s.dtype) for x in (bits << shift, (bits + 1) << shift))
        return bits - first, (s - left) / (right - left), right - left


def _force_per_length(network: RadialPotential, s: Tensor) -> tuple[Tensor, Tensor]:
    """2 dphi/ds at s, and its derivative with respect to s."""
    s = s.clone().requires_grad_()
    r = s.sqrt().unsqueeze(-1)
    force = (network.slope(r) / r).squeeze(-1)
    (slope,) = torch.autograd.grad(force.sum(), s)
    return force.detach(), slope


def _hermite(value: Tensor, slope: Tensor, width: Tensor) -> Tensor:
    """Cubics that meet values and slopes at the knots, ``(cells, 4)`` by powers of t."""
    a, b, m, n = value[:-1], value[1:], slope[:-1] * width, slope[1:] * width
    return torch.stack([a, m, 3 * (b - a) - 2 * m - n, 2 * (a - b) + m + n], -1)


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
        coefficients = _interpolated(copy.deepcopy(network).double(), cells)
        size, half = DEGREE + 1, cells // 2
        near = slice(PADDING - 2, PADDING - 2 + cells + DEGREE)
        blocks = coefficients[near, near].unfold(0, size, 1).unfold(1, size, 1)
        basis = segment_basis(DEGREE)
        polynomials = basis @ blocks[:, half:] @ basis.T
        # Coefficient of s^i t^j of cell (x, y), the powers of t side by side.
        self.register_buffer("table", polynomials.reshape(cells * half, size * size))

    def lookup(self, dtype: torch.dtype) -> tuple[int, int]:
        """Cells along each side of the square, and nothing more."""
        return self.resolution, 0

    def spline_energy(self, displacement: Tensor) -> Tensor:
        rows, _, s, _ = self._rows(displacement / (REACH + soft_length(displacement)))
        return horner(rows, s)[0]

    def spline_gradient(self, displacement: Tensor) -> Tensor:
        r = soft_length(displacement)
        rows, slopes, s, sign = self._rows(displacement / (REACH + r))
        slope = torch.stack([horner(rows, s)[1], horner(slopes, s)[0]], -1)
        return unsquashed(slope * (sign * self.resolution / 2), displacement, r)

    def _rows(self, u: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Values and slopes in t for each power of s ``(..., 6)``, then s and the sign of u."""
        sign = torch.where(u[..., 1:] < 0, -1, 1).to(u.dtype)
        at = u * sign * (self.resolution / 2)
        corner = at.detach().floor()
        x, y = corner.long().unbind(-1)
        half = self.resolution // 2
        s, t = (at - corner).unbind(-1)
        table = self.table[(x + half) * half + y].unflatten(-1, (DEGREE + 1, DEGREE + 1))
        return *horner(table, t.unsqueeze(-1)), s, sign


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
    for factor in coefficients.flip(-1).unbind(-1):
        value, slope = value * t + factor, slope * t + value
    return value, slope
