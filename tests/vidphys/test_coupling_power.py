"""The coupling-power test: what it decides, when it abstains, what it asks for; and its worlds."""

from dataclasses import replace

import pytest
import torch
from torch import Generator

from dynamics import (
    Hamiltonian,
    PairLaw,
    Parameters,
    PhaseState,
    rollout,
    terms,
)
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import PairPotential
from dynamics.triples import LearnedTriple, PlummerTriple
from vidphys.coupling_power import coupling_power, measured_forces
from vidphys.coupling_verdict import (
    CANDIDATES,
    CONTRADICTED,
    SUPPORTED,
    UNDECIDED,
    UNEXPLAINED_LAW,
    PowerVerdict,
    deciding_query,
)
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.coupling import selection
from vidphys.experiments.coupling.misspecification import MISSPECIFICATION
from vidphys.presets import OracleSizes
from vidphys.scenes import certify
from vidphys.scenes.changed_laws import gravity_of_power, three_body_gravity

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)
each_power = pytest.mark.parametrize("power", CANDIDATES)


def recorded(power, episodes=24, coupling=None, seed=0, law=None):
    scene = gravity_of_power(power)
    scene = scene if law is None else replace(scene, law=law)
    start, params = scene.sample(episodes, Generator().manual_seed(seed))
    if coupling is not None:
        params = params.with_coupling(coupling)
    return measured_forces(scene.simulate(start, params, 80, 4))


# --- the verdict -------------------------------------------------------------------------------


@each_power
def test_positive_data_leave_the_sign_open_and_name_the_query_that_decides(power):
    verdict = coupling_power(recorded(power))
    # Windows of 8 steps: a force in their middle instead of its mean leaves ten times as much.
    assert verdict.unexplained[power] < 1e-4
    if power in ("linear", "even"):
        assert verdict.supported == ("linear", "even")
        assert verdict.query is not None
        assert -1.5 < verdict.query < -0.5
        assert f"measure at G = {verdict.query:.3g}" in verdict.why
        asked = recorded(power, 1, verdict.query, seed=9)
        verdict = coupling_power(recorded(power).joined(asked))
    assert verdict.supported == (power,)
    assert verdict.query is None


class LogarithmicPairs(PairPotential):
    """phi = log sqrt(r^2 + 0.2^2), whose force is none of those that the test fits."""

    def pair_energy(self, displacement):
        return 0.5 * (displacement.square().sum(-1) + 0.04).log()

    def pair_gradient(self, displacement):
        return displacement / (displacement.square().sum(-1, keepdim=True) + 0.04)


@each_power
def test_a_law_of_another_shape_is_decided_too(power):
    law = Hamiltonian(FixedKinetic(), LogarithmicPairs(PairLaw(coupling=power)))
    verdict = coupling_power(recorded(power, law=law))
    assert power in verdict.supported
    assert set(verdict.supported) <= {power, "linear", "even"}
    assert verdict.unexplained[power] < 1e-2


def test_one_coupling_alone_decides_nothing():
    verdict = coupling_power(recorded("linear", coupling=1.0))
    assert verdict.supported == CANDIDATES
    assert verdict.query == pytest.approx(-0.5, rel=3e-15)
    asked = recorded("linear", 2, verdict.query, seed=9)
    again = coupling_power(recorded("linear", coupling=1.0).joined(asked))
    assert again.supported == ("linear",)


def test_a_misspecified_prior_is_flagged_before_any_counterfactual():
    assert coupling_power(recorded("quadratic")).of("linear") == CONTRADICTED
    assert coupling_power(recorded("even")).of("linear") == UNDECIDED
    assert coupling_power(recorded("linear")).of("linear") == UNDECIDED
    assert coupling_power(recorded("quadratic")).of("quadratic") == SUPPORTED
    assert PowerVerdict((), {}, None, "").of("linear") == UNEXPLAINED_LAW


def test_forces_that_no_pair_law_makes_support_nothing():
    forces = recorded("linear")
    noise = torch.randn(forces.force.shape, generator=Generator().manual_seed(0)).double()
    verdict = coupling_power(replace(forces, force=noise))
    assert verdict.supported == ()
    assert "not that of pairs" in verdict.why


def test_a_confinement_and_a_friction_do_not_mislead():
    forces = recorded("linear")
    velocity = forces.state.p / forces.mass[:, None, :, None]
    other = (-2.0 * forces.state.q - 0.5 * velocity)[:, 1:-1]
    verdict = coupling_power(replace(forces, force=forces.force + other))
    assert verdict.supported == ("linear", "even")


def test_the_order_and_the_units_of_the_records_change_nothing():
    forces = recorded("quadratic")
    stronger = replace(forces, force=1e3 * forces.force)
    assert coupling_power(stronger).supported == ("quadratic",)
    backwards = replace(forces, coupling=-forces.coupling)
    assert coupling_power(backwards).supported == ("quadratic",)


@pytest.mark.parametrize(
    ("candidates", "seen", "query"),
    [
        (("linear", "even"), 1.0, -1.0),
        (("linear", "even"), -2.0, 2.0),
        (("linear", "cubic"), 1.0, -0.5),
        (CANDIDATES, 1.0, -0.5),
        (("linear", "linear"), 1.0, None),
    ],
)
def test_the_query_parts_all_that_is_left(candidates, seen, query):
    assert deciding_query(candidates, seen) == query


def test_impossible_questions_are_refused():
    forces = recorded("linear", 2)
    with pytest.raises(ValueError, match=r"unknown \['odd'\]; known: linear"):
        coupling_power(forces, ("odd",))
    with pytest.raises(ValueError, match="two episodes or more"):
        coupling_power(recorded("linear", 1))
    with pytest.raises(ValueError, match="every coupling is zero"):
        coupling_power(recorded("linear", 3, 0.0))
    with pytest.raises(ValueError, match="must not be zero"):
        deciding_query(("linear", "even"), 0.0)
    scene = gravity_of_power("linear")
    start, params = scene.sample(2, Generator().manual_seed(0))
    with pytest.raises(ValueError, match="three states or more, got 2"):
        measured_forces(scene.simulate(start, params, 1))
    path = scene.simulate(start, params, 4)
    broken = replace(path, first_bad=torch.tensor([-1, 2]))
    with pytest.raises(ValueError, match="not finite"):
        measured_forces(broken)


def test_measured_forces_are_the_mean_force_of_their_window():
    scene = gravity_of_power("linear")
    start, params = scene.sample(3, Generator().manual_seed(0))
    path = scene.simulate(start, params, 8, 2)
    force = measured_forces(path).force
    truth = (path.states.p[:, 4] - path.states.p[:, 2]) / (4 * scene.dt)
    assert torch.allclose(force[:, 2], truth, rtol=3e-15, atol=3e-15)


# --- the worlds --------------------------------------------------------------------------------


@pytest.mark.parametrize(("power", "parity"), [("even", 1), ("quadratic", 1), ("cubic", -1)])
def test_the_parity_of_a_power_is_exact(power, parity):
    scene = gravity_of_power(power)
    start, params = scene.sample(4, Generator().manual_seed(0))
    force = scene.law.force(start, params)
    flipped = scene.law.force(start, params.with_coupling(-params.coupling))
    assert torch.equal(flipped, parity * force)


def states(bodies=5, batch=3, seed=0):
    rng = Generator().manual_seed(seed)
    q = torch.randn(batch, bodies, 2, generator=rng, dtype=torch.float64)
    mass = 0.5 + torch.rand(batch, bodies, generator=rng, dtype=torch.float64)
    return q, Parameters(torch.randn(batch, generator=rng, dtype=torch.float64), mass)


TRIPLES = {
    "plummer": lambda: PlummerTriple(0.5, 2.0),
    "learned": lambda: LearnedTriple(8, "tanh").double(),
}


@pytest.mark.parametrize("name", TRIPLES)
def test_three_body_forces_are_gradients_and_push_nothing_as_a_whole(name):
    q, params = states()
    potential = TRIPLES[name]()
    x = q.clone().requires_grad_()
    (slope,) = torch.autograd.grad(potential.energy(x, params).sum(), x)
    force = potential.force(q, params)
    assert torch.allclose(force, -slope, atol=3e-15, rtol=1e-12)
    assert float(force.detach().sum(-2).abs().max()) < 1e-14
    turning = q[..., 0] * force[..., 1] - q[..., 1] * force[..., 0]
    assert float(turning.detach().sum(-1).abs().max()) < 1e-14


@pytest.mark.parametrize("name", TRIPLES)
def test_three_body_forces_are_odd_in_the_coupling_bitwise(name):
    q, params = states()
    potential = TRIPLES[name]()
    force = potential.force(q, params)
    assert torch.equal(potential.force(q, params.with_coupling(-params.coupling)), -force)


@pytest.mark.parametrize("name", TRIPLES)
def test_exchanging_bodies_exchanges_three_body_forces(name):
    q, params = states()
    order = torch.tensor([3, 0, 4, 1, 2])
    potential = TRIPLES[name]()
    moved = potential.force(q[:, order], Parameters(params.coupling, params.mass[:, order]))
    assert torch.allclose(moved, potential.force(q, params)[:, order], atol=3e-15, rtol=1e-14)


@pytest.mark.parametrize("name", TRIPLES)
def test_two_bodies_have_no_three_body_force(name):
    q, params = states(bodies=2)
    potential = TRIPLES[name]()
    assert float(potential.force(q, params).detach().abs().max()) == 0
    assert float(potential.energy(q, params).detach().abs().max()) == 0


def test_a_three_body_force_is_no_sum_over_pairs():
    """Far away, a third body makes a pair force no weaker; it does this one."""
    q = torch.tensor([[[0.0, 0.0], [1.0, 0.0], [0.0, 100.0]]], dtype=torch.float64)
    near = q.clone()
    near[0, 2] = torch.tensor([0.5, 1.0])
    params = Parameters(torch.ones(1).double(), torch.ones(1, 3).double())
    law = PlummerTriple(0.5)
    pull = law.force(q, params)[0, 0, 0], law.force(near, params)[0, 0, 0]
    assert float(pull[0]) < 1e-3 * float(pull[1])


def test_the_three_body_world_conserves_its_energy():
    scene = three_body_gravity()
    start, params = scene.sample(8, Generator().manual_seed(0))
    path = scene.simulate(start, params, 500, 5)
    assert bool(certify(scene, path).passed.all())


def test_a_softening_of_nothing_is_refused():
    with pytest.raises(ValueError, match="softening must be > 0, got 0"):
        PlummerTriple(0.0)


def test_a_head_with_triples_rolls_and_conserves():
    scene = three_body_gravity()
    start, params = scene.sample(2, Generator().manual_seed(0))
    head = scene.build(
        terms.Hamiltonian(potentials=(terms.Displacement(width=8), terms.Triple(width=8)))
    ).double()
    path = rollout(head, start, params, 200, 0.002, 10)
    energy = head.energy(path.states, params.map(lambda x: x.unsqueeze(1)))
    assert float((energy - energy[:, :1]).abs().max().detach()) < 1e-7
    assert isinstance(path.states, PhaseState)


# --- tables ------------------------------------------------------------------------------------


def numbers(task):
    return {
        (row["cell"], row["metric"], row["coupling"]): row["value"]
        for recorder in task.recorders
        for row in recorder.rows
    }


@pytest.mark.parametrize(
    "cell", ["even-factored", pytest.param("three-body-factored-triples", marks=pytest.mark.slow)]
)
def test_misspecification_cells_leave_their_numbers(cell):
    task = CellTask("misspecification", cell, (0,), TINY)
    MISSPECIFICATION.cells[cell](task)
    found = numbers(task)
    assert found[cell, "in_distribution_nmse", None] is not None
    assert found[cell, "inversion_nmse", -1.0] is not None
    if cell == "even-factored":
        assert found[cell, "power_warned", None] == 1
        assert found[cell, "power_query", None] < 0
        assert found[cell, "truth_distance", -1.0] == 0
        assert found[cell, "certified_fraction", None] == 1


def test_queries_decide_and_positive_data_do_not(monkeypatch):
    monkeypatch.setattr(selection, "TRIALS", 3)
    task = CellTask("selection", "gravity", (0,), TINY)
    selection.SELECTION.cells["gravity"](task)
    found = numbers(task)
    clean = "gravity/clean"
    assert found[f"{clean}/positive-only", "unique_selection", None] == 0.5
    assert found[f"{clean}/fixed", "unique_selection", None] == 1
    assert found[f"{clean}/named", "unique_selection", None] == 1
    assert found[f"{clean}/positive-only", "linear_prior_warned", None] == 1
    assert found[f"{clean}/fixed", "wrong_selection", None] == 0
