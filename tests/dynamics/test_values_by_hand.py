"""Learned laws of known weights against the same written out in NumPy, and laws with known values.

Properties (an energy that stays, a force that is a gradient) leave a sign or a factor open that
only a value tells.
"""

import numpy as np
import pytest
import torch
from torch.distributions import Normal

from dynamics import Parameters, PhaseState
from dynamics.bath import ExactBath
from dynamics.hybrid import Shortcut
from dynamics.mlp import MLP
from dynamics.potentials import SoftenedGravity
from dynamics.stochastic import HalfSteps, NeuralSDE
from dynamics.unstructured import NeuralODE
from vidphys.scenes.gravity import gravity
from vidphys.scenes.oscillators import coupling_stiffness, curl_matrix

EPISODES, BODIES, SPACE, WIDTH = 2, 3, 2, 4
TWO_PI = float(np.log(2 * np.pi) / 2)  # what a density leaves out, for each coordinate


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    rng = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=rng, dtype=torch.float64)


def drawn(seed: int = 0) -> tuple[PhaseState, Parameters]:
    q, p = normal(2, EPISODES, BODIES, SPACE, seed=seed)
    masses = 1 + 0.3 * normal(EPISODES, BODIES, seed=seed + 1).tanh()
    return PhaseState(q, p), Parameters(normal(EPISODES, seed=seed + 2), masses)


def by_hand(network: MLP, x: np.ndarray, activation) -> np.ndarray:
    *hidden, last = [(y.weight.detach().numpy(), y.bias.detach().numpy()) for y in network.layers]
    for weight, bias in hidden:
        x = activation(x @ weight.T + bias)
    return x @ last[0].T + last[1]


def silu(x: np.ndarray) -> np.ndarray:
    return x / (1 + np.exp(-x))


def inputs(state: PhaseState, params: Parameters) -> np.ndarray:
    return torch.cat([state.flat, params.flat], -1).numpy()


@pytest.mark.parametrize("near", [1.0, 1e-3])  # at a thousandth the rounding of r = 0 is seen
def test_a_shortcut_pushes_by_its_network_s_odd_part(near):
    torch.manual_seed(0)
    law = Shortcut(SoftenedGravity(0.1), SPACE, WIDTH).double()
    state, params = drawn()
    q, mass, coupling = near * state.q, params.mass.numpy(), params.coupling.numpy()
    expected = np.zeros(q.shape)
    for episode in range(EPISODES):
        for i in range(BODIES):
            for j in range(i + 1, BODIES):
                apart = (q[episode, i] - q[episode, j]).numpy()
                u = 2 * apart / (0.5 + np.sqrt(apart @ apart + 1e-6))
                told = [mass[episode, i], mass[episode, j], coupling[episode]]
                back = [mass[episode, j], mass[episode, i], coupling[episode]]
                there = by_hand(law.free, np.array([*u, *told]), np.tanh)
                push = (there - by_hand(law.free, np.array([*-u, *back]), np.tanh)) / 2
                expected[episode, i] += push
                expected[episode, j] -= push
    found = law.free_force(q, params).detach()
    torch.testing.assert_close(found, torch.from_numpy(expected), rtol=0, atol=3e-15)


def test_a_neural_ode_s_slopes_are_its_network_at_each_part_s_rate():
    state, params = drawn()
    torch.manual_seed(0)
    head = NeuralODE(BODIES, SPACE, params.flat.shape[-1], WIDTH, 0.125).double()
    head.set_scale(0.25, 3.0)
    out = by_hand(head.network, inputs(state, params), silu)
    q, p = (x.reshape(state.q.shape) for x in np.split(out, 2, -1))
    slopes = [x.detach() for x in head.slopes(state, params)]
    torch.testing.assert_close(slopes[0], torch.from_numpy(2.0 * q), rtol=0, atol=3e-15)
    torch.testing.assert_close(slopes[1], torch.from_numpy(24.0 * p), rtol=3e-15, atol=3e-15)
    torch.testing.assert_close(head.force(state, params).detach(), slopes[1], rtol=0, atol=0)


def test_a_neural_sde_s_density_is_the_normal_one_of_its_network():
    state, params = drawn()
    torch.manual_seed(0)
    head = NeuralSDE(BODIES, SPACE, params.flat.shape[-1], WIDTH, 0.125).double()
    head.set_scale(0.25, 3.0)
    drift, raw = np.split(by_hand(head.network, inputs(state, params), silu), 2, -1)
    size = np.repeat([0.25, 3.0], BODIES * SPACE)
    dt = 0.125 / 4  # a quarter of what it was told for: half the spread
    mean, deviation = size * drift / 4, size / 2 * (np.log1p(np.exp(raw)) + 1e-3)
    found = [x.detach() for x in head.moments(state, params, dt)]
    torch.testing.assert_close(found[0], torch.from_numpy(mean), rtol=3e-15, atol=3e-15)
    torch.testing.assert_close(found[1], torch.from_numpy(deviation), rtol=3e-15, atol=3e-15)
    step = PhaseState(*normal(2, EPISODES, BODIES, SPACE, seed=5))
    density = Normal(torch.from_numpy(mean), torch.from_numpy(deviation)).log_prob(step.flat)
    expected = -(density + TWO_PI).sum(-1)
    nll = head.nll(state, step, params, dt).detach()
    torch.testing.assert_close(nll, expected, rtol=3e-15, atol=0)


def test_the_density_of_half_steps_is_that_of_two_ornstein_uhlenbeck_steps():
    friction, temperature, dt = 0.7, 0.4, 0.3
    _, params = drawn()
    told = {"friction": friction, "temperature": temperature}
    ones = torch.ones(EPISODES, dtype=torch.float64)
    params = Parameters(ones, params.mass, None, {name: x * ones for name, x in told.items()})
    before, after = normal(2, 2, EPISODES, BODIES, SPACE, seed=7)
    decay = np.exp(-friction * dt / 2)
    spread = (params.mass.unsqueeze(-1) * temperature * (1 - decay**2)).sqrt()
    density = Normal(decay * before, spread).log_prob(after)
    expected = -(density + TWO_PI).sum((0, -2, -1))
    found = HalfSteps(before, after).nll(ExactBath(), params, dt)
    torch.testing.assert_close(found, expected, rtol=3e-15, atol=0)


def test_the_rings_stiffness_has_the_eigenvalues_of_its_bonds():
    # A ring's Laplacian has 0, 2, 2, 4; a bond to the ground adds 1; the largest is scaled to 1.5.
    for kind, values in (("coupled", [0.0, 0.75, 0.75, 1.5]), ("modified", [0.3, 0.9, 0.9, 1.5])):
        found = torch.linalg.eigvalsh(coupling_stiffness(kind))
        expected = torch.tensor(values, dtype=torch.float64)
        torch.testing.assert_close(found, expected, rtol=0, atol=3e-15)


def test_the_curl_pushes_each_coordinate_along_the_next_one_and_against_the_last():
    # The ring's C has a norm of 0.375 |(0, 2, 2, 4)|; eight entries share its part of it.
    found = curl_matrix(0.1, "coupled")
    size = 0.1 * 0.375 * 24**0.5 / 8**0.5
    ring = torch.tensor([[0.0, 1, 0, -1], [-1, 0, 1, 0], [0, -1, 0, 1], [1, 0, -1, 0]])
    torch.testing.assert_close(found, size * ring.double(), rtol=0, atol=3e-16)


def test_the_energy_scale_is_kinetic_energy_and_the_potential_s_size():
    q = torch.tensor([[[-0.6, 0.0], [0.6, 0.0]]], dtype=torch.float64)
    state = PhaseState(q, torch.tensor([[[0.0, 0.5], [0.0, -0.5]]], dtype=torch.float64))
    params = Parameters(torch.ones(1), torch.tensor([[1.0, 2.0]])).map(torch.Tensor.double)
    kinetic, potential = 0.5 * (0.25 + 0.25 / 2), 2 / (1.2**2 + 0.1**2) ** 0.5
    found = gravity(bodies=2).energy_scale(state, params)
    assert float(found) == pytest.approx(kinetic + potential, rel=3e-15)
