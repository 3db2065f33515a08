"""Heat baths: exact steps, fluctuation-dissipation, passivity, and what the table records."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from dynamics import Hamiltonian, Parameters, PhaseState, build, rollout, terms
from dynamics.bath import (
    Bath,
    ExactBath,
    FactoredBath,
    FullBath,
    NoSteadyState,
    PassiveBath,
    UntiedBath,
)
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap
from dynamics.stochastic import NeuralSDE, half_steps
from dynamics.terms import TERMS
from vidphys.errors import InputError
from vidphys.experiments.core.bars import ABSENT, judge, rows_of
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.heat import bath as training
from vidphys.experiments.heat import temperature, thermostat
from vidphys.experiments.heat.thermal import measure_temperature
from vidphys.presets import OracleSizes
from vidphys.runs.records import merged_tables
from vidphys.scenes.langevin import langevin
from vidphys.training.ensemble import Ensemble, stack
from vidphys.training.segments import from_trajectory, scale_of

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)


def bath_params(n, friction, temperature, mass=(0.5, 1.0, 2.0), **more) -> Parameters:
    ones = torch.ones(n, dtype=torch.float64)
    scalars = {"friction": friction, "temperature": temperature, **more}
    return Parameters(
        ones,
        torch.tensor(mass, dtype=torch.float64).expand(n, -1),
        None,
        {name: value * ones for name, value in scalars.items()},
    )


def momenta(n, seed=0) -> PhaseState:
    rng = torch.Generator().manual_seed(seed)
    p = torch.randn(n, 3, 2, generator=rng, dtype=torch.float64)
    return PhaseState(torch.zeros_like(p), p)


def made(kind, seed=0) -> Bath:
    """A bath in float64 with weights that no two coordinates share."""
    torch.manual_seed(seed)
    bath = kind(3, 2).double()
    for weight in bath.parameters():
        weight.data += 0.5 * torch.randn_like(weight)
    return bath


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.floats(0.1, 3.0), st.floats(1e-3, 3.0))
def test_two_steps_are_one_step_of_twice_the_length(friction, drive, heat, dt):
    params = bath_params(1, friction, heat, drive=drive)
    decay, variance = ExactBath().moments(params, dt)
    twice, together = ExactBath().moments(params, 2 * dt)
    torch.testing.assert_close(decay.square(), twice, rtol=1e-14, atol=1e-14)
    torch.testing.assert_close(
        decay.square() * variance + variance, together, rtol=1e-14, atol=1e-14
    )


@pytest.mark.parametrize("turns", [0.01, 1.0, 100.0])
def test_a_step_of_any_length_keeps_the_exact_variance(turns):
    n, heat = 40_000, 0.7
    params = bath_params(n, 2.0, heat)
    mass = params.mass.unsqueeze(-1)
    settled = momenta(n).map(lambda p: p * (heat * mass).sqrt())
    torch.manual_seed(1)
    after = ExactBath().kick(settled, params, turns / 2.0)
    torch.testing.assert_close(
        (after.square() / mass).mean((0, 2)), torch.full((3,), heat).double(), rtol=0.02, atol=0
    )


@pytest.mark.parametrize("kind", [ExactBath, PassiveBath, FactoredBath])
def test_noise_over_a_short_time_is_twice_the_temperature_times_the_friction(kind):
    bath = kind() if kind is ExactBath else made(kind)
    params, dt = bath_params(1, 1.3, 0.7), 1e-6
    _, variance = bath.moments(params, dt)
    mobility = bath.friction(params) * params.mass.unsqueeze(-1)
    expected = (2 * 0.7 * mobility).expand_as(variance)
    torch.testing.assert_close(variance / dt, expected, rtol=1e-4, atol=0)


def operator_of(bath: FullBath, params: Parameters) -> Tensor:
    """M of dp = -M v dt, in coordinates, for the first episode."""
    root = params.mass[0].sqrt().repeat_interleave(2)
    rate = bath.strength(params.scalar("friction"))[0].squeeze() * bath.operator
    return (root[:, None] * rate * root[None, :]).detach()


def test_the_full_operator_has_the_noise_that_belongs_to_it():
    bath, n, dt, heat = made(FullBath), 200_000, 0.3, 0.7
    params = bath_params(n, 1.3, heat)
    still = PhaseState(torch.zeros(n, 3, 2).double(), torch.zeros(n, 3, 2).double())
    torch.manual_seed(2)
    with torch.no_grad():
        noise = bath.kick(still, params, dt).flatten(1)
    mass = params.mass[0].repeat_interleave(2)
    friction = operator_of(bath, params)
    # dp = -M m^-1 p dt: its propagator over dt, without eigenvectors.
    decay = torch.linalg.matrix_exp(-dt * friction / mass)
    expected = heat * (torch.diag(mass) - decay @ torch.diag(mass) @ decay.mT)
    assert float((noise.T.cov() - expected).abs().max()) < 0.02 * float(expected.abs().max())
    assert float((expected - torch.diag(expected.diag())).abs().max()) > 0.05  # it is correlated
    with torch.no_grad():
        short = bath.kick(still, params, 1e-5).flatten(1).T.cov() / 1e-5
    assert float((short - 2 * heat * friction).abs().max()) < 0.02 * float(friction.abs().max())


@pytest.mark.parametrize("kind", [PassiveBath, FactoredBath, UntiedBath, FullBath])
def test_the_likelihood_is_the_density_of_the_step(kind):
    bath, dt = made(kind), 0.4
    params = bath_params(1, 1.3, 0.7)
    before, one, two = momenta(1, 1).p, momenta(1, 2).p, momenta(1, 3).p
    still = PhaseState(before, torch.zeros_like(before))
    torch.manual_seed(3)
    n = 100_000
    with torch.no_grad():
        many = bath_params(n, 1.3, 0.7)
        noise = bath.kick(PhaseState(*[torch.zeros(n, 3, 2).double()] * 2), many, dt).flatten(1)
        columns = []
        for index in range(6):  # the step's linear part, at temperature 0
            p = torch.zeros(6).double()
            p[index] = 1
            cold = params.with_scalar("temperature", 0.0)
            columns.append(bath.kick(PhaseState(still.q, p.view(1, 3, 2)), cold, dt).flatten())
    mean = torch.stack(columns, 1) @ before.flatten()
    normal = torch.distributions.MultivariateNormal(mean, noise.T.cov())
    found = bath.nll(before, one, params, dt) - bath.nll(before, two, params, dt)
    expected = normal.log_prob(two.flatten()) - normal.log_prob(one.flatten())
    torch.testing.assert_close(found.detach(), expected.view(1), rtol=0.03, atol=0.05)


@torch.no_grad()
def test_the_force_of_a_neural_sde_is_the_mean_that_its_momenta_gain():
    params, start = bath_params(1, 1.3, 0.7), momenta(1)
    head = NeuralSDE(3, 2, params.flat.shape[-1], 4, 0.1).double()
    last = head.network.layers[-1]
    last.weight.zero_()
    last.bias.copy_(torch.cat([torch.arange(12) - 3.0, torch.full((12,), -50.0)]))  # no noise
    gained = (head.advance(start, params, 0.1)[0].p - start.p) / 0.1
    torch.testing.assert_close(head.force(start, params), gained, atol=0.05, rtol=0)


@pytest.mark.parametrize("kind", [PassiveBath, FullBath])
def test_the_likelihood_knows_how_wide_steps_scatter(kind):
    bath, n, found = made(kind), 4000, []
    still = momenta(n).map(torch.zeros_like)
    for dt, heat in ((0.4, 0.7), (0.1, 2.0)):
        params = bath_params(n, 1.3, heat)
        with torch.no_grad():
            after = bath.kick(still, params, dt)
            surprise = bath.nll(still.p, after, params, dt).mean()
        # Of a normal step: half of log det of its covariance, and what no parameter changes.
        found.append(float(surprise - 0.5 * after.flatten(1).T.cov().logdet()))
    assert found[0] == pytest.approx(found[1], abs=0.1)


def test_a_full_operator_without_friction_has_a_likelihood():
    bath, params = made(FullBath), bath_params(1, 1.3, 0.7)
    bath.raw.data.zero_()
    p = momenta(1).p
    assert bool(torch.isfinite(bath.nll(p, p, params, 0.4)).all())


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.floats(-3.0, 3.0), st.floats(1e-3, 10.0))
@pytest.mark.parametrize("kind", [PassiveBath, UntiedBath, FullBath])
def test_passive_friction_never_injects(kind, seed, friction, dt):
    """P4: whatever the weights and the told friction, the port takes energy (temperature 0)."""
    params, state = bath_params(8, friction, 0.0), momenta(8, seed)
    with torch.no_grad():
        after = made(kind, seed).kick(state, params, dt)
    energy = (state.p.square() / params.mass.unsqueeze(-1)).sum((-2, -1))
    left = (after.square() / params.mass.unsqueeze(-1)).sum((-2, -1))
    assert float((left / energy).max()) - 1 < 3e-15


def test_factored_friction_injects_when_its_sign_is_turned():
    params, state = bath_params(8, -0.5, 0.0), momenta(8)
    after = made(FactoredBath).kick(state, params, 0.1)
    assert bool((after.abs() > state.p.abs()).all())


@pytest.mark.parametrize("name", [n for n in TERMS if n.endswith("bath") and "state" not in n])
def test_negative_friction_in_a_warm_bath_is_refused(name):
    """P4: 2 T M would be a negative covariance."""
    head = build(terms.Hamiltonian(potentials=(terms.Trap(1.0),), ports=(TERMS[name](),)), 3, 0.05)
    warm = bath_params(4, -0.5, 1.0, drive=0.0).map(Tensor.float)
    with pytest.raises(ValueError, match="no real noise covariance") as told:
        rollout(head, momenta(4).map(Tensor.float), warm, 3, 0.05)
    assert "\n" not in str(told.value)


def test_negative_friction_without_heat_is_rolled_and_said_to_have_no_steady_state():
    params = bath_params(4, -0.5, 0.0)
    law = Hamiltonian(FixedKinetic(), HarmonicTrap(1.0), ports=[ExactBath()])
    with pytest.warns(NoSteadyState):
        rolled = rollout(law, momenta(4), params, 40, 0.05, every=40)
    assert bool((law.energy(rolled.at(-1), params) > law.energy(rolled.at(0), params)).all())


def test_a_state_dependent_mobility_is_refused_with_its_reason():
    with pytest.raises(NotImplementedError, match="T div M"):
        build(terms.Hamiltonian(ports=(terms.StateDependentBath(),)), 3, 0.05)


def test_a_seed_makes_the_noise_and_leaves_the_global_generator_alone():
    scene = langevin()
    start, params = scene.sample(5, torch.Generator().manual_seed(0))
    torch.manual_seed(7)
    expected = torch.rand(1)
    torch.manual_seed(7)
    one = scene.simulate(start, params, 10, seed=3)
    assert torch.equal(torch.rand(1), expected)
    same, other = (
        scene.simulate(start, params, 10, seed=3),
        scene.simulate(start, params, 10, seed=4),
    )
    assert one.seed == 3
    assert torch.equal(one.states.p, same.states.p)
    assert not torch.equal(one.states.p[:, -1], other.states.p[:, -1])


def test_momentum_is_maxwellian_in_a_trap_at_a_long_step():
    """Half bath, leapfrog, half bath: exact for harmonic forces, here at omega dt = 0.8."""
    law = Hamiltonian(FixedKinetic(), HarmonicTrap(1.0), ports=[ExactBath()])
    params = bath_params(4000, 1.0, 0.7, mass=(1.0, 1.0, 1.0))
    rolled = rollout(law, momenta(4000), params, 40, 0.8, every=20, seed=0)
    assert float(rolled.at(-1).p.square().mean()) == pytest.approx(0.7, rel=0.03)


def test_the_step_is_undone_into_the_noise_of_its_halves():
    scene = langevin()
    start, params = scene.sample(4000, torch.Generator().manual_seed(0))
    end = scene.simulate(start, params, 1, seed=1).at(-1)
    step = PhaseState(end.q - start.q, end.p - start.p)
    halves = half_steps(scene.exact, start, step, params, scene.dt)
    decay, variance = ExactBath().moments(params, scene.dt / 2)
    first, second = (halves.after - decay * halves.before) / variance.sqrt()
    assert float(first.square().mean()) == pytest.approx(1, abs=0.03)
    assert float(second.square().mean()) == pytest.approx(1, abs=0.03)
    assert abs(float((first * second).mean())) < 0.03


def test_without_heat_the_halves_are_those_of_the_friction():
    scene = langevin()
    start, params = scene.sample(8, torch.Generator().manual_seed(0))
    params = params.with_scalar("temperature", 0.0)
    end = rollout(scene.exact, start, params, 1, 0.3, substeps=False).at(-1)
    step = PhaseState(end.q - start.q, end.p - start.p)
    halves = half_steps(scene.exact, start, step, params, 0.3)
    decay, _ = ExactBath().moments(params, 0.15)
    torch.testing.assert_close(halves.after, decay * halves.before, rtol=1e-14, atol=1e-14)


def test_half_steps_refuse_what_is_not_leapfrog():
    scene = langevin()
    trapped = (terms.Trap(1.0),)
    term = terms.Hamiltonian(potentials=trapped, ports=(terms.Bath(),), integrator="yoshida4")
    head = build(term, 3, 0.05)
    start, params = scene.sample(2, torch.Generator().manual_seed(0))
    with pytest.raises(ValueError, match="leapfrog"):
        half_steps(head, start, start, params, 0.05)


def test_a_baths_numbers_are_found_from_all_steps():
    scene = langevin()
    seen = training.bath_trajectory(scene, 64, 0, 64 * 400)
    head = Hamiltonian(FixedKinetic(), scene.exact.potential, ports=[UntiedBath(3, 2)])
    training.refine(head, seen)
    params = seen.params.map(Tensor.float)
    true = params.scalar("friction")[:, None, None]
    found = training.bath_of(head)
    torch.testing.assert_close(found.noise(params).mean((-2, -1)), true[:, 0, 0], rtol=0.02, atol=0)
    torch.testing.assert_close(
        found.friction(params).mean((-2, -1)), true[:, 0, 0], rtol=0.1, atol=0
    )


@pytest.mark.parametrize("name", list(thermostat.TERMS))
def test_heads_learn_side_by_side_as_alone(name):
    scene = langevin()
    batch = from_trajectory(scene.simulate(*scene.sample(8, torch.Generator()), 2, seed=0), k=1)
    scale = scale_of(batch)
    heads = []
    for seed in range(2):
        torch.manual_seed(seed)
        heads.append(scene.build(thermostat.TERMS[name]))
        heads[-1].set_scale(scale.q, scale.p)
    alone = torch.stack([training.likelihood(head, batch, scale) for head in heads])
    together = Ensemble(heads).map(
        lambda head, b: training.likelihood(head, b, scale), stack([batch, batch])
    )
    torch.testing.assert_close(together, alone, rtol=1e-6, atol=1e-6)


def test_a_neural_sde_spreads_as_its_diffusion_says():
    torch.manual_seed(0)
    scene = langevin()
    head = scene.build(terms.Diffusion())
    head.set_scale(0.1, 0.3)
    start, params = scene.sample(1, torch.Generator().manual_seed(0))
    start = start.map(lambda x: x.float().expand(20_000, -1, -1))
    params = params.map(lambda x: x.float().expand(20_000, *x.shape[1:]))
    with torch.no_grad():
        mean, deviation = head.moments(start, params, 0.2)
        step = head.advance(start, params, 0.2)[0].flat - start.flat
    torch.testing.assert_close(step.std(0), deviation[0], rtol=0.03, atol=0)
    torch.testing.assert_close(step.mean(0), mean[0], rtol=0, atol=0.05 * float(deviation.max()))


def test_the_standard_error_is_that_of_correlated_walkers():
    rng = torch.Generator().manual_seed(0)
    rho, walkers, length = 0.8, 200, 320
    x = torch.randn(walkers, generator=rng).double()
    series = []
    for _ in range(length):
        noise = torch.randn(walkers, generator=rng).double()
        x = rho * x + (1 - rho**2) ** 0.5 * noise
        series.append(1 + x)
    measured = measure_temperature(torch.stack(series, 1), 32, rng)
    exact = ((1 + rho) / (1 - rho) / (walkers * length)) ** 0.5
    assert measured.value == pytest.approx(1, abs=4 * exact)
    assert measured.error == pytest.approx(exact, rel=0.25)


def test_a_lost_walker_leaves_no_temperature_and_too_little_data_is_refused():
    series = torch.ones(4, 8)
    series[2, 5] = torch.nan
    lost = measure_temperature(series, 4, torch.Generator())
    assert (lost.value, lost.lost, lost.walkers) == (None, 1, 4)
    with pytest.raises(InputError, match="two blocks"):
        measure_temperature(torch.ones(1, 7), 4, torch.Generator())


@pytest.mark.parametrize("baths", [[], [(0.0, 1.0)], [(1.0, -1.0)]])
def test_a_scene_refuses_what_is_no_bath(baths):
    with pytest.raises(InputError, match="langevin"):
        langevin(baths)


def ask_briefly(monkeypatch):
    """The same questions, asked for a moment."""
    monkeypatch.setattr(temperature, "BURN_IN", 0.5)
    monkeypatch.setattr(temperature, "MEASURED", 4.0)
    monkeypatch.setattr(training, "SHORTEST", 8)
    monkeypatch.setattr(training, "LONGEST", 16)
    monkeypatch.setattr(thermostat, "CERTIFIED_STEPS", 10)
    monkeypatch.setattr(thermostat, "LYAPUNOV_ROUNDS", 2)


@pytest.mark.slow
@pytest.mark.parametrize("table", [thermostat.THERMOSTAT, thermostat.MEASUREMENT_NOISE])
def test_every_row_of_a_table_finds_its_number(table, monkeypatch):
    ask_briefly(monkeypatch)
    recorders = []
    for name, cell in table.cells.items():
        task = CellTask(table.name, name, (0,), TINY)
        cell(task)
        recorders += task.recorders
    records, episodes = merged_tables(recorders)
    for row in rows_of(table.name):
        assert judge(row, records.to_pylist()).verdict != ABSENT, row
    assert "kinetic_temperature" in episodes.column("metric").to_pylist()
