"""A scene of one's own: two bodies in a trap, whose energy is checked as ours are."""

import torch

from dynamics import Hamiltonian, Parameters, PhaseState
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import SoftenedGravity
from vidphys.scenes import Scene


def sample(n, rng):
    """Two bodies near the middle, at rest."""
    q = 0.5 * torch.randn(n, 2, 2, generator=rng, dtype=torch.float64)
    law = Parameters(torch.ones(n, dtype=torch.float64), torch.ones(n, 2, dtype=torch.float64))
    return PhaseState(q, torch.zeros_like(q)), law


scene = Scene("pair", Hamiltonian(FixedKinetic(), SoftenedGravity(0.2)), sample, 2, 0.002, {})
start, law = scene.sample(4, torch.Generator().manual_seed(0))
truth = scene.simulate(start, law, steps=500)
energy = scene.energy(truth.states, law)
drift = ((energy - energy[:, :1]) / energy[:, :1]).abs().max()
print(f"energy holds to {float(drift):.1e} over {truth.states.q.shape[1] - 1} steps")
