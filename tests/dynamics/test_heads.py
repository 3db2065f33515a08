"""States, energies, heads and rollouts: the physics that must hold by construction."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from torch import Tensor, nn

from dynamics import (
    HEADS,
    Hamiltonian,
    Head,
    Parameters,
    PhaseState,
    ballistic,
    build,
    leapfrog,
    rollout,
    terms,
    yoshida4,
)
from dynamics.activations import SILU, SOFTPLUS, TANH
from dynamics.building import parameter_count
from dynamics.fields import UniformField
from dynamics.kinetic import BodyKinetic, FixedKinetic, FreeKinetic, Kinetic
from dynamics.mlp import MLP
from dynamics.pairs import pair_indices
from dynamics.potentials import (
    DisplacementPotential,
    FreePotential,
    NoPotential,
    PairPotential,
    Potential,
    RadialPotential,
    SoftenedGravity,
)
from dynamics.shapes import SHAPES, ShapedPotential
from dynamics.unstructured import ResidualMap
from tests.shared.problems import three_bodies

ACTIVATIONS = (TANH, SOFTPLUS, SILU)
BODIES, DT = 3, 0.002
HAMILTONIAN_HEADS = tuple(k for k in HEADS.ours() if isinstance(HEADS[k], terms.Hamiltonian))
PAIR_HEADS = ("factored", "factored-radial", "factored-learned-kinetic")

PAIR_POTENTIALS: dict[str, Callable[[], PairPotential]] = {
    "gravity": lambda: SoftenedGravity(0.1),
    "displacement": lambda: DisplacementPotential(2, 16, TANH),
    "radial": lambda: RadialPotential(16, TANH),
    **{
        name: partial(ShapedPotential, name, 0.7, 9.0 if name == "cut-off" else 1.4)
        for name, shape in SHAPES.items()
        if not shape.sharp  # those have tests of their own
    },
}
POTENTIALS: dict[str, Callable[[], Potential]] = {
    **PAIR_POTENTIALS,
    "free": lambda: FreePotential(2 * BODIES, BODIES + 1, 16, TANH),
    "none": lambda: NoPotential(),
}
KINETICS: dict[str, Callable[[], Kinetic]] = {
    "fixed": lambda: FixedKinetic(),
    "body": lambda: BodyKinetic(2, 16, TANH),
    "free": lambda: FreeKinetic(2 * BODIES, BODIES + 1, 16, TANH),
}

each_activation = pytest.mark.parametrize("activation", ACTIVATIONS)
each_pair_potential = pytest.mark.parametrize("name", PAIR_POTENTIALS)
each_potential = pytest.mark.parametrize("name", POTENTIALS)
each_kinetic = pytest.mark.parametrize("name", KINETICS)
each_head = pytest.mark.parametrize("name", HEADS.ours())
each_hamiltonian_head = pytest.mark.parametrize("name", HAMILTONIAN_HEADS)
in_float64 = pytest.mark.usefixtures("float64")


def largest(x: Tensor) -> float:
    return float(x.detach().abs().max())


def episode(*batch: int, bodies: int = BODIES) -> tuple[PhaseState, Parameters]:
    """Random states and parameters, masses in [0.5, 1.5], couplings of either sign."""
    state = PhaseState(torch.randn(*batch, bodies, 2), torch.randn(*batch, bodies, 2))
    return state, Parameters(torch.randn(batch), 0.5 + torch.rand(*batch, bodies))


def head_of(name: str) -> Head:
    return build(HEADS[name], BODIES, DT)


def wiggled(module: nn.Module) -> nn.Module:
    """Larger weights than at initialisation, so that no term is too small to be seen."""
    with torch.no_grad():
        for parameter in module.parameters():
            parameter += 0.3 * torch.randn_like(parameter)
    return module


# --- states and parameters ---------------------------------------------------------------------


def test_flat_and_back() -> None:
    state, _ = episode(4, 5)
    assert state.flat.shape == (4, 5, 12)
    assert torch.equal(state.flat[..., :2], state.q[..., 0, :])
    assert torch.equal(state.flat[..., -2:], state.p[..., -1, :])
    back = PhaseState.from_flat(state.flat, BODIES)
    assert torch.equal(back.q, state.q)
    assert torch.equal(back.p, state.p)


@pytest.mark.usefixtures("unchecked")
def test_a_state_needs_one_shape() -> None:
    with pytest.raises(ValueError, match=r"one shape.*\(2, 3\).*\(3, 2\)"):
        PhaseState(torch.zeros(2, 3), torch.zeros(3, 2))


def test_indexing_reversal_and_stacking() -> None:
    state, params = episode(4)
    assert torch.equal(state[1:3].p, state.p[1:3])
    assert torch.equal(params[2].mass, params.mass[2])
    assert torch.equal(state.reversed.q, state.q)
    assert torch.equal(state.reversed.p, -state.p)
    stacked = PhaseState.stack([state, state.reversed], -3)
    assert stacked.q.shape == (4, 2, BODIES, 2)
    assert torch.equal(stacked.p[:, 1], -state.p)


def test_parameters_are_given_to_networks_coupling_first() -> None:
    _, params = episode(4)
    assert torch.equal(params.flat[:, 0], params.coupling)
    assert torch.equal(params.flat[:, 1:], params.mass)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_another_coupling_keeps_the_bodies(dtype: torch.dtype) -> None:
    params = episode(4)[1].map(lambda x: x.to(dtype))
    before = params.coupling.clone()
    changed = params.with_coupling(-0.5)
    assert torch.equal(changed.coupling, torch.full((4,), -0.5, dtype=dtype))
    assert changed.coupling.dtype == dtype
    assert torch.equal(changed.mass, params.mass)
    assert torch.equal(params.coupling, before)
    assert torch.equal(params.with_coupling(-before).coupling, -before)


# --- the network's own gradient ----------------------------------------------------------------


@in_float64
@each_activation
def test_the_written_gradient_is_the_gradient(activation: str) -> None:
    network = wiggled(MLP((3, 8, 7, 1), activation))
    x = (2 * torch.randn(5, 4, 3)).requires_grad_()
    (expected,) = torch.autograd.grad(network(x).sum(), x)
    assert largest(expected) > 0.1
    assert largest(network.gradient(x) - expected) < 1e-14


@in_float64
@each_activation
def test_training_through_the_gradient_equals_a_double_backward(activation: str) -> None:
    network = wiggled(MLP((3, 8, 7, 1), activation))
    x = torch.randn(5, 3, requires_grad=True)
    (automatic,) = torch.autograd.grad(network(x).sum(), x, create_graph=True)
    weights = list(network.parameters())[:-1]  # the last bias moves no force
    expected = torch.autograd.grad(automatic.square().sum(), weights)
    written = torch.autograd.grad(network.gradient(x).square().sum(), weights)
    for a, b in zip(written, expected, strict=True):
        assert largest(a) > 1e-3
        assert largest(a - b) < 1e-14


def test_an_unknown_activation_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown activation 'relu'; known: tanh, softplus, silu"):
        MLP((2, 4, 1), "relu")


# --- energies and what follows from them -------------------------------------------------------


@in_float64
@each_potential
def test_force_is_minus_the_gradient_of_the_energy(name: str) -> None:
    potential = wiggled(POTENTIALS[name]())
    state, params = episode(5, 4)
    q = state.q.requires_grad_()
    energy = potential.energy(q, params)
    assert energy.shape == (5, 4)
    force = potential.force(q, params)
    if name == "none":
        assert largest(force) == largest(energy) == 0
        return
    (gradient,) = torch.autograd.grad(energy.sum(), q)
    assert largest(gradient) > 0.01
    assert largest(force + gradient) < 1e-13


@in_float64
@each_kinetic
def test_velocity_is_the_gradient_of_the_kinetic_energy(name: str) -> None:
    kinetic = wiggled(KINETICS[name]())
    state, params = episode(5, 4)
    p = state.p.requires_grad_()
    energy = kinetic.energy(p, params)
    assert energy.shape == (5, 4)
    (gradient,) = torch.autograd.grad(energy.sum(), p)
    assert largest(gradient) > 0.01
    assert largest(kinetic.velocity(p, params) - gradient) < 1e-14


@in_float64
@each_potential
def test_forces_are_twice_differentiable(name: str) -> None:
    potential = POTENTIALS[name]()
    state, params = episode(2)
    inputs = [x.requires_grad_() for x in (state.q, params.coupling, params.mass)]

    def force(q: Tensor, coupling: Tensor, mass: Tensor) -> Tensor:
        return potential.force(q, Parameters(coupling, mass))

    if name == "none":
        assert not force(*inputs).requires_grad
        return
    assert torch.autograd.gradcheck(force, inputs)
    assert torch.autograd.gradgradcheck(force, inputs)


@in_float64
def test_gravity_is_the_law_of_the_study() -> None:
    """V = -sum G m_i m_j / sqrt(r^2 + eps^2), T = sum |p|^2 / 2m, body by body."""
    head, state, params = three_bodies()
    m, expected = params.mass.tolist(), 0.0
    for i in range(BODIES):
        expected += float(state.p[i].square().sum()) / (2 * m[i])
        for j in range(i):
            r2 = float((state.q[i] - state.q[j]).square().sum())
            expected -= 1.5 * m[i] * m[j] / math.sqrt(r2 + 0.01)
    params = params.with_coupling(1.5)
    assert float(head.energy(state, params)) == pytest.approx(expected, rel=3e-15)
    assert largest(head.force(state, params) - head.potential.force(state.q, params)) == 0


@in_float64
def test_gravity_attracts_and_its_inverse_repels() -> None:
    q = torch.tensor([[-0.5, 0.0], [0.5, 0.0]])
    params = Parameters(torch.tensor(1.0), torch.tensor([2.0, 3.0]))
    pull = SoftenedGravity(0.1).force(q, params)
    assert pull[0, 0] == pytest.approx(6 / 1.01**1.5, rel=3e-15)
    assert pull[1, 0] == -pull[0, 0]
    assert SoftenedGravity(0.1).force(q, params.with_coupling(-1.0))[0, 0] < 0


@pytest.mark.parametrize("softening", [0.0, -0.1, math.nan])
def test_softening_must_be_positive(softening: float) -> None:
    with pytest.raises(ValueError, match="softening must be > 0"):
        SoftenedGravity(softening)


@in_float64
def test_the_zero_force_predictor_moves_straight() -> None:
    state, params = episode(4)
    run = rollout(ballistic(), state, params, 10, 0.1)
    expected = state.q + state.p / params.mass.unsqueeze(-1)
    assert largest(run.at(-1).q - expected) < 1e-14
    assert torch.equal(run.at(-1).p, state.p)
    assert torch.equal(ballistic().energy(state, params), FixedKinetic().energy(state.p, params))


# --- oddness in G, in every bit ----------------------------------------------------------------


def bits(x: Tensor) -> Tensor:
    return x.view(torch.int32 if x.dtype == torch.float32 else torch.int64)


@each_pair_potential
@pytest.mark.parametrize("width", [32, 64])
@given(data=st.data())
def test_force_is_odd_in_the_coupling_bitwise(name: str, width: int, data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 6), label="bodies")
    numbers = st.floats(-10, 10, width=width)
    q = torch.from_numpy(data.draw(arrays(f"float{width}", (n, 2), elements=numbers), label="q"))
    coupling = torch.tensor(data.draw(numbers, label="G"), dtype=q.dtype)
    params = Parameters(coupling, torch.linspace(0.5, 1.5, n, dtype=q.dtype))
    potential = PAIR_POTENTIALS[name]().to(q.dtype)
    force = potential.force(q, params)
    inverted = potential.force(q, params.with_coupling(-coupling))
    assert force.isfinite().all()
    assert torch.equal(bits(inverted), bits(-force))


@in_float64
def test_an_unfactored_force_is_not_odd() -> None:
    """The negative control: nothing ties G to the force of a free network, but it sees G."""
    potential = wiggled(FreePotential(2 * BODIES, BODIES + 1, 16, TANH))
    state, params = episode()
    params = params.with_coupling(2.0)
    force = potential.force(state.q, params)
    inverted = potential.force(state.q, params.with_coupling(-params.coupling))
    assert largest(inverted + force) > 0.01
    assert largest(inverted - force) > 0.01


# --- symmetries of pair potentials -------------------------------------------------------------


@in_float64
@each_pair_potential
@pytest.mark.parametrize("bodies", [2, 3, 4, 5, 6])
def test_exchanging_bodies_exchanges_forces(name: str, bodies: int) -> None:
    potential = wiggled(PAIR_POTENTIALS[name]())
    state, params = episode(3, bodies=bodies)
    order = torch.arange(bodies).roll(1)
    exchanged = Parameters(params.coupling, params.mass[:, order])
    force = potential.force(state.q, params)
    assert largest(force) > 1e-3
    assert largest(potential.force(state.q[:, order], exchanged) - force[:, order]) < 1e-14
    change = potential.energy(state.q[:, order], exchanged) - potential.energy(state.q, params)
    assert largest(change) < 1e-13


@in_float64
@each_pair_potential
def test_moving_everything_changes_nothing(name: str) -> None:
    potential = wiggled(PAIR_POTENTIALS[name]())
    state, params = episode(3)
    moved = state.q + torch.tensor([3.0, -2.0])
    assert largest(potential.force(moved, params) - potential.force(state.q, params)) < 1e-14
    assert largest(potential.energy(moved, params) - potential.energy(state.q, params)) < 3e-15


def turned(x: Tensor) -> Tensor:
    cos, sin = math.cos(0.7), math.sin(0.7)
    return x @ torch.tensor([[cos, sin], [-sin, cos]])


@in_float64
@pytest.mark.parametrize(("name", "holds"), [("gravity", 1), ("radial", 1), ("displacement", 0)])
def test_rotation_is_built_into_the_radial_laws_only(name: str, holds: int) -> None:
    potential = wiggled(PAIR_POTENTIALS[name]())
    state, params = episode(3)
    force = potential.force(turned(state.q), params)
    assert (largest(force - turned(potential.force(state.q, params))) < 1e-14) == bool(holds)


@in_float64
@each_pair_potential
def test_a_body_alone_feels_nothing(name: str) -> None:
    potential = PAIR_POTENTIALS[name]()
    state, params = episode(4, bodies=1)
    assert torch.equal(potential.force(state.q, params), torch.zeros_like(state.q))
    assert torch.equal(potential.energy(state.q, params), torch.zeros(4))
    run = rollout(Hamiltonian(FixedKinetic(), potential), state, params, 5, 0.1)
    assert torch.equal(run.at(-1).p, state.p)


@in_float64
@each_pair_potential
def test_coincident_bodies_have_finite_forces_and_gradients(name: str) -> None:
    potential = PAIR_POTENTIALS[name]()
    q = torch.zeros(BODIES, 2, requires_grad=True)
    _, params = episode()
    force = potential.force(q, params)
    assert largest(force) < 1e-15
    energy = potential.energy(q, params)
    inputs = [q, *potential.parameters()]
    weight = torch.randn_like(force)
    for output in (energy, (weight * force).sum()):
        gradients = torch.autograd.grad(output, inputs, allow_unused=True, retain_graph=True)
        assert all(g.isfinite().all() for g in gradients if g is not None)


@in_float64
@each_pair_potential
def test_the_force_is_linear_in_the_coupling_and_each_pair_of_masses(name: str) -> None:
    potential = wiggled(PAIR_POTENTIALS[name]())
    state, params = episode(3, bodies=2)
    force = potential.force(state.q, params)
    doubled = Parameters(2 * params.coupling, params.mass * torch.tensor([3.0, 5.0]))
    assert largest(potential.force(state.q, doubled) / force - 30) < 1e-13
    energies = potential.energy(state.q, doubled) / potential.energy(state.q, params)
    assert largest(energies - 30) < 1e-13


@in_float64
@pytest.mark.parametrize(("name", "power"), [("displacement", 1), ("radial", 2)])
def test_learned_forces_vanish_at_infinity(name: str, power: int) -> None:
    """As 1 / r^2 along the displacement and as 1 / r across it, which only one of them has."""
    potential = wiggled(PAIR_POTENTIALS[name]())
    params = Parameters(torch.tensor(1.0), torch.ones(2))
    apart = torch.tensor([[0.0, 0.0], [0.6, 0.8]])
    far, farther = (largest(potential.force(r * apart, params)) for r in (1e4, 2e4))
    assert far < 1e-4
    assert far / farther == pytest.approx(2**power, rel=1e-2)


def angular_momentum(s: PhaseState) -> Tensor:
    return (s.q[..., 0] * s.p[..., 1] - s.q[..., 1] * s.p[..., 0]).sum(-1)


@in_float64
@pytest.mark.parametrize("integrator", [leapfrog, yoshida4], ids=lambda m: m.name)
@pytest.mark.parametrize(("name", "spin"), [("gravity", 1), ("displacement", 0), ("radial", 1)])
def test_total_momenta_are_conserved(name: str, spin: int, integrator) -> None:
    _, start, params = three_bodies()
    head = Hamiltonian(FixedKinetic(), wiggled(PAIR_POTENTIALS[name]()), integrator)
    steps = 2000 if integrator is leapfrog else 200
    end = rollout(head, start, params, steps, DT, every=steps).at(-1)
    assert largest(end.p - start.p) > 0.01
    assert largest(end.p.sum(0) - start.p.sum(0)) < 1e-13
    change = largest(angular_momentum(end) - angular_momentum(start))
    assert (change < 1e-13) == bool(spin)


# --- heads -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("unstructured", 139_020),
        ("symplectic", 137_730),
        ("factored", 4_417),
        ("factored-radial", 4_417),
        ("factored-learned-kinetic", 4_417 + 4_481),
    ],
)
def test_parameter_counts(name: str, count: int) -> None:
    assert parameter_count(head_of(name)) == count


def test_the_study_s_heads_are_what_their_names_say() -> None:
    parts = {
        name: (type(head.kinetic), type(head.potential), head.integrator)
        for name in HAMILTONIAN_HEADS
        if isinstance(head := head_of(name), Hamiltonian)
    }
    assert parts == {
        "factored": (FixedKinetic, DisplacementPotential, leapfrog),
        "factored-radial": (FixedKinetic, RadialPotential, leapfrog),
        "factored-learned-kinetic": (BodyKinetic, DisplacementPotential, leapfrog),
        "symplectic": (FreeKinetic, FreePotential, leapfrog),
    }


@in_float64
@each_hamiltonian_head
@pytest.mark.parametrize("integrator", ["leapfrog", "yoshida4", "implicit_midpoint"])
def test_learned_flows_are_symplectic(name: str, integrator: str) -> None:
    term = HEADS[name].throughout(width=8, integrator=integrator)
    head = wiggled(build(term, BODIES, DT))
    state, params = episode()
    head.requires_grad_(False)

    def step(x: Tensor) -> Tensor:
        return head.advance(PhaseState.from_flat(x, BODIES), params, 0.1)[0].flat

    jacobian = torch.autograd.functional.jacobian(step, state.flat, vectorize=True)
    eye, zero = torch.eye(6), torch.zeros(6, 6)
    omega = torch.cat([torch.cat([zero, eye], 1), torch.cat([-eye, zero], 1)])
    assert largest(jacobian - torch.eye(12)) > 0.01
    assert largest(jacobian.T @ omega @ jacobian - omega) < 1e-13


@in_float64
@each_hamiltonian_head
def test_learned_flows_run_backwards(name: str) -> None:
    head = wiggled(head_of(name))
    state, params = episode(2)
    there = rollout(head, state, params, 100, 0.02).at(-1)
    back = rollout(head, there, params, 100, -0.02).at(-1)
    assert largest(there.flat - state.flat) > 0.1
    assert largest(back.flat - state.flat) < 1e-11


@in_float64
@each_hamiltonian_head
def test_learned_energies_are_conserved_to_second_order(name: str) -> None:
    head = wiggled(head_of(name))
    state, params = episode()
    errors = []
    for steps in (100, 200):
        run = rollout(head, state, params, steps, 2 / steps)
        energies = torch.stack([head.energy(run.at(t), params) for t in range(steps + 1)])
        errors.append(largest(energies - energies[0]))
    assert errors[0] / errors[1] == pytest.approx(4, abs=0.4)


@in_float64
@each_head
def test_one_step_trains_every_weight_that_matters(name: str) -> None:
    head = wiggled(head_of(name))
    state, params = episode(8)

    def loss() -> Tensor:
        return head.advance(state, params, DT)[0].flat.sub(1).square().sum()

    loss().backward()
    direction, expected = {}, 0.0
    for key, weight in head.named_parameters():
        if weight.grad is None:  # energies are known up to a constant: their last bias
            assert isinstance(head, Hamiltonian)
            assert key.endswith("layers.2.bias")
            continue
        assert weight.grad.isfinite().all()
        assert largest(weight.grad) > 0
        direction[weight] = torch.randn_like(weight)
        expected += float((weight.grad * direction[weight]).sum())
    h, values = 1e-5, []
    with torch.no_grad():
        for sign in (1, -2):  # to +h, then from there to -h
            for weight, way in direction.items():
                weight += sign * h * way
            values.append(float(loss()))
    assert (values[0] - values[1]) / (2 * h) == pytest.approx(expected, rel=1e-5)


@each_head
def test_a_model_of_no_bodies_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="at least one body, got bodies = 0"):
        build(HEADS[name], 0, DT)


@each_head
@pytest.mark.parametrize("bodies", [1, 2, 5])
def test_heads_of_any_number_of_bodies_in_space(name: str, bodies: int) -> None:
    head = build(HEADS[name], bodies, DT, space=3)
    state = PhaseState(torch.randn(4, bodies, 3), torch.randn(4, bodies, 3))
    params = Parameters(torch.ones(4), torch.ones(4, bodies))
    after, _ = head.advance(state, params, DT)
    assert after.q.shape == (4, bodies, 3)
    assert head.force(state, params).shape == (4, bodies, 3)


def test_pair_indices_made_in_inference_mode_can_be_trained_through() -> None:
    pair_indices.cache_clear()
    state, params = episode(2)
    with torch.inference_mode():
        SoftenedGravity().force(state.q.clone(), params)
    q = state.q.requires_grad_()
    SoftenedGravity().force(q, params).sum().backward()
    assert q.grad is not None


# --- the unstructured map ----------------------------------------------------------------------


@in_float64
def test_the_residual_map_adds_a_scaled_network() -> None:
    head = ResidualMap(BODIES, 2, BODIES + 1, 16, DT)
    head.set_scale(q=0.5, p=3.0)
    state, params = episode(4)
    after, _ = head.advance(state, params, DT)
    out = head.network(torch.cat([state.q.flatten(-2), state.p.flatten(-2), params.flat], -1))
    assert largest((after.q - state.q).flatten(-2) - 0.5 * out[:, :6]) < 1e-15
    assert largest((after.p - state.p).flatten(-2) - 3.0 * out[:, 6:]) < 1e-15
    assert "scale" in head.state_dict()


@in_float64
def test_the_effective_force_of_a_map_is_its_momentum_gain_per_second() -> None:
    head = wiggled(ResidualMap(BODIES, 2, BODIES + 1, 16, DT))
    state, params = episode(4)
    after, _ = head.advance(state, params, DT)
    assert largest(head.force(state, params) - (after.p - state.p) / DT) < 1e-12


@pytest.mark.parametrize("dt", [0.001, -DT, 0.0020001])
def test_a_map_refuses_another_step(dt: float) -> None:
    state, params = episode()
    with pytest.raises(ValueError, match=r"trained for dt = 0\.002 s, cannot step by"):
        head_of("unstructured").advance(state, params, dt)


# --- rollouts ----------------------------------------------------------------------------------


@in_float64
@each_head
def test_a_rollout_holds_its_start_and_every_state(name: str) -> None:
    head = head_of(name)
    state, params = episode(3)
    run = rollout(head, state, params, 6, DT)
    assert run.states.q.shape == (3, 7, BODIES, 2)
    assert torch.equal(run.at(0).flat, state.flat)
    now, memory = state, None
    for t in range(1, 7):
        now, memory = head.advance(now, params, DT, memory)
        assert torch.equal(run.at(t).flat, now.flat)
    assert run.params is params
    assert run.times.tolist() == pytest.approx([DT * t for t in range(7)], rel=3e-15)
    assert run.finite.tolist() == [True] * 3


@in_float64
def test_every_keeps_each_so_many_states() -> None:
    head = head_of("factored")
    state, params = episode(3)
    full, thin = rollout(head, state, params, 12, DT), rollout(head, state, params, 12, DT, every=4)
    assert torch.equal(thin.states.flat, full.states.flat[:, ::4])
    assert thin.dt == pytest.approx(4 * DT, rel=3e-15)
    assert thin.times.tolist() == pytest.approx([0, 4 * DT, 8 * DT, 12 * DT], rel=3e-15)


def test_a_rollout_of_no_steps_is_its_start() -> None:
    state, params = episode(3)
    run = rollout(head_of("factored"), state, params, 0, DT)
    assert torch.equal(run.states.q, state.q.unsqueeze(1))
    assert run.first_bad.tolist() == [-1] * 3


@pytest.mark.parametrize(
    ("steps", "every", "message"),
    [
        (10, 3, "steps = 10 is not a multiple of every = 3"),
        (10, 0, "steps >= 0 and every >= 1, got 10 and 0"),
        (10, -2, "steps >= 0 and every >= 1, got 10 and -2"),
        (-10, 2, "steps >= 0 and every >= 1, got -10 and 2"),
    ],
)
def test_impossible_lengths_are_refused(steps: int, every: int, message: str) -> None:
    state, params = episode()
    with pytest.raises(ValueError, match=message):
        rollout(head_of("factored"), state, params, steps, DT, every)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_start_that_is_not_finite_is_refused(value: float) -> None:
    state, params = episode(3)
    state.p[1, 2, 0] = value
    with pytest.raises(ValueError, match=r"p\[1, 2, 0\] is not finite"):
        rollout(head_of("factored"), state, params, 10, DT)


class Explosive(Hamiltonian):
    """Straight lines, until step ``when`` spoils one number of episode 1, for one step only."""

    def __init__(self, when: int, part: str, value: float) -> None:
        super().__init__(FixedKinetic(), NoPotential())
        self.when, self.part, self.value, self.done = when, part, value, 0

    def advance(self, state, params, dt, memory=None):
        self.done += 1
        after, memory = super().advance(state.map(torch.nan_to_num), params, dt, memory)
        if self.done == self.when:
            getattr(after, self.part)[1, 2, 1] = self.value
        return after, memory


@pytest.mark.parametrize("part", ["q", "p"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize(("when", "every", "index"), [(4, 1, 4), (4, 2, 2), (8, 4, 2), (1, 1, 1)])
def test_the_first_bad_step_is_reported_and_the_others_go_on(
    part: str, value: float, when: int, every: int, index: int
) -> None:
    state, params = episode(3)
    run = rollout(Explosive(when, part, value), state, params, 8, 0.1, every)
    assert run.first_bad.tolist() == [-1, index, -1]
    assert run.finite.tolist() == [True, False, True]
    straight = rollout(ballistic(), state, params, 8, 0.1, every)
    assert torch.equal(run.states.q[[0, 2]], straight.states.q[[0, 2]])
    assert not getattr(run.states, part)[1, index, 2, 1].isfinite()


def test_an_episode_that_blows_up_stays_non_finite() -> None:
    state, params = episode(3)
    fast = PhaseState(state.q, state.p.clone())
    fast.p[1] = 1e38
    run = rollout(ballistic(), fast, params, 50, 1.0)
    assert run.finite.tolist() == [True, False, True]
    first = int(run.first_bad[1])
    assert run.at(first - 1).flat[1].isfinite().all()
    assert not any(run.at(t).flat[1].isfinite().all() for t in range(first, 51))


def test_a_single_episode_needs_no_batch() -> None:
    state, params = episode()
    run = rollout(head_of("factored"), state, params, 5, DT)
    assert run.states.q.shape == (6, BODIES, 2)
    assert run.first_bad.shape == ()
    assert bool(run.finite)


@in_float64
@each_head
def test_an_episode_rolls_alone_as_in_a_batch(name: str) -> None:
    head = wiggled(head_of(name))
    head.set_scale(1e-3, 1e-3)
    state, params = episode(2, 3)
    together = rollout(head, state, params, 20, DT)
    alone = rollout(head, state[1:, 2:], params[1:, 2:], 20, DT)
    bare = rollout(head, state[1, 2], params[1, 2], 20, DT)
    assert largest(together.states.flat[1, 2] - alone.states.flat[0, 0]) < 1e-13
    assert largest(together.states.flat[1, 2] - bare.states.flat) < 1e-13


def test_no_gradient_is_recorded() -> None:
    state, params = episode()
    run = rollout(head_of("factored"), state.map(Tensor.requires_grad_), params, 3, DT)
    assert not run.states.q.requires_grad
    assert not run.states.p.requires_grad


@in_float64
def test_a_fork_starts_from_the_stored_state_under_another_law() -> None:
    head, start, params = three_bodies()
    run = rollout(head, start, params, 20, DT)
    before = run.states.flat.clone()
    fork = rollout(head, run.at(10), run.params.with_coupling(-1.0), 10, DT)
    same = rollout(head, run.at(10), run.params, 10, DT)
    assert torch.equal(fork.at(0).flat, run.at(10).flat)
    assert torch.equal(same.states.flat, run.states.flat[10:])
    assert largest(fork.at(-1).flat - run.at(-1).flat) > 1e-4
    assert largest((fork.at(1).p - fork.at(0).p) + (same.at(1).p - same.at(0).p)) < 1e-7
    assert torch.equal(run.states.flat, before)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@each_head
def test_a_rollout_keeps_the_precision_of_its_state(name: str, dtype: torch.dtype) -> None:
    state, params = episode(2)
    head = head_of(name).to(dtype)
    run = rollout(head, state.map(lambda x: x.to(dtype)), params.map(lambda x: x.to(dtype)), 3, DT)
    assert run.states.q.dtype == run.states.p.dtype == dtype


def test_friction_takes_energy_at_its_exact_rate_and_none_is_the_conservative_head():
    from dynamics.ports import LinearFriction

    torch.manual_seed(0)
    term = terms.Hamiltonian(ports=(terms.LinearFriction(),))
    head = build(term, bodies=3, dt=0.01).double()
    (port,) = head.ports
    assert isinstance(port, LinearFriction)
    p = torch.randn(2, 3, 2, dtype=torch.float64)
    params = Parameters(torch.ones(2).double(), torch.ones(2, 3).double())
    rate = float(port.rate.detach())
    for dt in (1e-3, 1.0, 1e3):
        factor = port.kick(PhaseState(p, p), params, dt) / p
        torch.testing.assert_close(
            factor, torch.full_like(p, math.exp(-rate * dt)), rtol=3e-15, atol=3e-15
        )
        assert ((factor >= 0) & (factor <= 1)).all()
    # Free bodies: two half steps of friction make one whole.
    free = Hamiltonian(FixedKinetic(), NoPotential(), ports=[port])
    state = PhaseState(torch.zeros_like(p), p)
    after, _ = free.advance(state, params, 0.5)
    torch.testing.assert_close(after.p, p * math.exp(-rate * 0.5), rtol=3e-15, atol=3e-15)
    # Taking the port off leaves the conservative model, bit for bit.
    plain = Hamiltonian(head.kinetic, head.potential)
    head.ports = torch.nn.ModuleList()
    q = torch.randn(2, 3, 2, dtype=torch.float64)
    ours, _ = head.advance(PhaseState(q, p), params, 0.01)
    theirs, _ = plain.advance(PhaseState(q, p), params, 0.01)
    assert torch.equal(ours.p, theirs.p) and torch.equal(ours.q, theirs.q)


def test_a_uniform_field_pulls_every_body_alike_along_itself(float64: None) -> None:
    field = UniformField(2)
    field.acceleration.data = torch.tensor([0.3, -9.8])
    state, params = episode(4)
    q = state.q.requires_grad_()
    (slope,) = torch.autograd.grad(field.energy(q, params).sum(), q)
    assert torch.equal(field.force(q, params), -slope)
    assert largest(field.force(q, params) / params.mass.unsqueeze(-1) - field.acceleration) < 3e-15
