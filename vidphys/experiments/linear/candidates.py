"""The factorial's candidates: stiffness fitted by ridge regression to contaminated forces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from dynamics import Hamiltonian, Head, Integrator, Parameters, PhaseState
from dynamics.coupling_maps import coupling_map
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap, SumPotential
from dynamics.stiffness import LinearField, QuadraticPotential, Stiffness
from vidphys.scenes import Scene
from vidphys.scenes.oscillators import CONFINEMENT
from vidphys.seeding import derive

RIDGE = 1e-6  # over the mean squared feature
LABEL_NOISE = 0.01  # standard deviation of the force labels' noise
REPRESENTATIONS = ("hamiltonian", "unrestricted")


@dataclass(frozen=True)
class ForceLabels:
    """What the candidates are fitted to: forces seen at states, in the observed regime only.

    Args:
        q: ``(..., m, n, 1)``.
        params: of each example, ``(..., m)``; G > 0.
        force: dp/dt with a curl that the truth does not have, and noise; shape of ``q``.
    """

    q: Tensor
    params: Parameters
    force: Tensor

    def __len__(self) -> int:
        return len(self.q)

    def __getitem__(self, index: Tensor | slice) -> ForceLabels:
        return ForceLabels(self.q[index], self.params[index], self.force[index])


def force_labels(scene: Scene, count: int, curl: Tensor, seed: int) -> ForceLabels:
    """Labels at ``count`` states that the scene's generator draws.

    Args:
        scene: gives states and true forces.
        count: m.
        curl: antisymmetric stiffness that contaminates the labels, ``(n, n)``.
        seed: of states and noise.
    """
    rng = Generator().manual_seed(derive(seed, "labels"))
    state, params = scene.sample(count, rng)
    noise = LABEL_NOISE * torch.randn(state.q.shape, generator=rng, dtype=torch.float64)
    return ForceLabels(state.q, params, scene.law.force(state, params) - curl @ state.q + noise)


def fit_stiffness(labels: ForceLabels, map_name: str) -> Tensor:
    """Ridge fit of the coupled stiffness, confinement known: matrices ``(..., k, n, n)``."""
    features = coupling_map(map_name)(labels.params.coupling)
    q = labels.q.squeeze(-1)
    k, n = features.shape[-1], q.shape[-1]
    design = (features.unsqueeze(-1) * q.unsqueeze(-2)).flatten(-2)
    target = -(labels.force.squeeze(-1) + CONFINEMENT * q)
    normal = design.mT @ design
    damping = RIDGE * normal.diagonal(dim1=-2, dim2=-1).mean(-1)[..., None, None]
    eye = torch.eye(k * n, dtype=q.dtype)
    weights = torch.linalg.solve(normal + damping * eye, design.mT @ target)
    return weights.reshape(*weights.shape[:-2], k, n, n).mT


def fit_ring(labels: ForceLabels) -> Tensor:
    """The smallest multiplicative map: eight scalars, four on the diagonal and four bonds."""
    eye = torch.eye(labels.q.shape[-2], dtype=torch.float64)
    after = eye.roll(1, 0)
    on_site = torch.einsum("si,sj->sij", eye, eye)
    bonds = torch.einsum("si,sj->sij", eye, after)
    basis = torch.cat([on_site, bonds + bonds.mT])
    pushed = torch.einsum("sij,mj->mis", basis, labels.q.squeeze(-1))
    design = (labels.params.coupling[:, None, None] * pushed).flatten(0, 1)
    target = -(labels.force + CONFINEMENT * labels.q).squeeze(-1).flatten()
    scalars = torch.linalg.lstsq(design, target).solution
    return torch.einsum("s,sij->ij", scalars, basis).unsqueeze(0)


def candidate(representation: str, content: Tensor, map_name: str, integrator: Integrator) -> Head:
    """The model of a fitted stiffness.

    A Hamiltonian takes the orthogonal projection on the symmetric matrices; an
    unrestricted field keeps the fit as it is.
    """
    if representation == "unrestricted":
        return LinearField(Stiffness(content, CONFINEMENT, map_name), integrator)
    symmetric = 0.5 * (content + content.mT)
    coupled = QuadraticPotential(Stiffness(symmetric, 0.0, map_name))
    potential = SumPotential([coupled, HarmonicTrap(CONFINEMENT)])
    return Hamiltonian(FixedKinetic(), potential, integrator)


def response(head: Head, q: Tensor, params: Parameters) -> Tensor:
    """The coupling's share of the force: all but the known confinement."""
    return head.force(PhaseState(q, torch.zeros_like(q)), params) + CONFINEMENT * q


def step_matrix(head: Head, params: Parameters, dt: float) -> Tensor:
    """One step of a linear model as a matrix on (q, p), ``(..., 2n, 2n)``."""
    n = params.mass.shape[-1]
    units = torch.eye(2 * n, dtype=torch.float64)
    columns = []
    for unit in units:
        x = unit.expand(*params.coupling.shape, 2 * n)
        after, _ = head.advance(PhaseState.from_flat(x, n, 1), params, dt)
        columns.append(after.flat)
    return torch.stack(columns, -1)


def roll_linear(
    head: Head, start: PhaseState, params: Parameters, steps: int, dt: float, every: int
) -> PhaseState:
    """The same states as a rollout, ``(..., t, n, 1)``, by powers of the step's matrix."""
    stride = torch.linalg.matrix_power(step_matrix(head, params, dt), every)
    x = start.flat.unsqueeze(-1)
    stored = [x]
    for _ in range(steps // every):
        x = stride @ x
        stored.append(x)
    flat = torch.stack(stored, -3).squeeze(-1)
    return PhaseState.from_flat(flat, params.mass.shape[-1], 1)
