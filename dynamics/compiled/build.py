"""How fine a spline must be for a tolerance of its force, measured against the float64 network."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import max_pool1d

from dynamics.compiled.spline import PairSpline, PlaneSpline, RadialSpline
from dynamics.head import Report
from dynamics.potentials import CORE, DisplacementPotential, PairPotential, RadialPotential

RADIAL_RESOLUTIONS = (0, 1, 2, 3, 4, 5, 6)  # log2 of the pieces of an octave
PLANE_RESOLUTIONS = (16, 32, 64, 128, 256)  # cells along a side
RADII, DIRECTIONS = 2000, 12  # at which the force is compared
NEIGHBOURS = 51  # radii over which the size of the force is taken: a third up and down


def pair_spline(
    network: RadialPotential | DisplacementPotential, tolerance: float, reach: float
) -> tuple[PairSpline, Report]:
    """The coarsest spline whose force meets a tolerance, in the network's floating type.

    Args:
        network: trained.
        tolerance: largest error, see :class:`Sample`.
        reach: distance in world units up to which the spline stands for the network.

    Raises:
        ValueError: no spline that is tried meets it; what the finest reaches is said.
    """
    weight = next(network.parameters())
    real, device = weight.dtype, weight.device
    exact = copy.deepcopy(network).cpu().double()
    sample = Sample.of(exact, reach)
    radial = isinstance(network, RadialPotential)
    kind: Any = RadialSpline if radial else PlaneSpline
    for resolution in RADIAL_RESOLUTIONS if radial else PLANE_RESOLUTIONS:
        spline: PairSpline = kind(exact, resolution, reach).to(real)
        error = sample.error(spline)
        if error <= tolerance:
            report = Report(tolerance, error, resolution, reach, spline.table.nbytes)
            return spline.to(device), report
    name = str(real).removeprefix("torch.")
    raise ValueError(
        f"compile_head: the finest spline ({resolution}) has a force error of {error:.1e} in "
        f"{name}, not {tolerance:.1e}; ask for a larger tolerance, or for None to keep the network"
    )


@dataclass(frozen=True)
class Sample:
    """A float64 network's pair forces, and what their errors are relative to.

    The distances are spread evenly in their logarithm, from deep in the core to ``reach``, so that
    a close encounter counts as much as the far field. The size is the largest force in any
    direction within a third of the distance: a force that passes through zero has a size there.

    Args:
        places: displacements ``(radii, directions, 2)``, each of which float32 holds exactly.
        forces: of the network there.
        size: ``(radii,)``.
    """

    places: Tensor
    forces: Tensor
    size: Tensor

    @classmethod
    def of(cls, network: PairPotential, reach: float) -> Sample:
        """Sample a network up to a distance in world units."""
        radii = torch.logspace(math.log10(CORE / 8), math.log10(0.999 * reach), RADII).double()
        directions = 1 if isinstance(network, RadialPotential) else DIRECTIONS
        golden = math.pi * (math.sqrt(5) - 1)
        turns = golden * torch.arange(RADII * directions).double().reshape(RADII, directions)
        places = radii[:, None, None] * torch.stack([turns.cos(), turns.sin()], -1)
        places = places.float().double()
        with torch.no_grad():
            forces = torch.cat([network.pair_gradient(part) for part in places.split(500)])
        largest = forces.norm(dim=-1).amax(-1)
        size = max_pool1d(largest[None, None], NEIGHBOURS, 1, NEIGHBOURS // 2)[0, 0]
        return cls(places, forces, size)

    def error(self, potential: PairPotential) -> float:
        """The largest relative error of another potential's force."""
        with torch.no_grad():
            wrong = potential.pair_gradient(self.places.to(dtype_of(potential))) - self.forces
        return float((wrong.norm(dim=-1).amax(-1) / self.size).max())


def dtype_of(potential: PairPotential) -> torch.dtype:
    """The floating type of a potential's parameters."""
    return next(potential.parameters()).dtype
