"""The factorial's systems, candidates and tables, against exact linear algebra."""

import math

import pytest
import torch
from torch import Generator

from dynamics import (
    INTEGRATORS,
    Hamiltonian,
    Parameters,
    PhaseState,
    build,
    implicit_midpoint,
    leapfrog,
    rk4,
    rollout,
    terms,
    yoshida4,
)
from dynamics.building import parameter_count
from dynamics.coupling_maps import MAPS, coupling_map
from dynamics.stiffness import LinearField, QuadraticPotential, Stiffness
from vidphys.errors import InputError
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.linear import factorial
from vidphys.experiments.linear.candidates import (
    REPRESENTATIONS,
    ForceLabels,
    candidate,
    fit_ring,
    fit_stiffness,
    force_labels,
    response,
    roll_linear,
)
from vidphys.experiments.linear.factorial import CURL_TABLE, FACTORIAL
from vidphys.experiments.linear.maps import MAPS as MAPS_TABLE
from vidphys.presets import OracleSizes
from vidphys.scenes import certify
from vidphys.scenes.oscillators import (
    CONFINEMENT,
    GROUNDED,
    coupling_stiffness,
    curl_matrix,
    oscillators,
)

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)
each_kind = pytest.mark.parametrize("kind", GROUNDED)


def drawn(kind="coupled", episodes=5, seed=0):
    scene = oscillators(kind)
    return scene, *scene.sample(episodes, Generator().manual_seed(seed))


def labels(kind="coupled", curl=0.0, count=400, noise=0.01, seed=0):
    scene = oscillators(kind)
    found = force_labels(scene, count, curl_matrix(curl, kind), seed)
    if noise:
        return found
    still = PhaseState(found.q, torch.zeros_like(found.q))
    force = scene.law.force(still, found.params) - curl_matrix(curl, kind) @ found.q
    return ForceLabels(found.q, found.params, force)


# --- systems -----------------------------------------------------------------------------------


@each_kind
def test_the_truth_solves_its_equations_and_keeps_its_energy(kind):
    scene, start, params = drawn(kind)
    path = scene.simulate(start, params, 4000, 100)
    assert bool(certify(scene, path).passed.all())
    fourth = Hamiltonian(scene.law.kinetic, scene.law.potential, yoshida4)
    fine = rollout(fourth, start, params, 500, 0.02, 500)
    assert torch.allclose(path.at(2).flat, fine.at(1).flat, atol=2e-5)
    exact = PhaseState(*(x[:, 2] for x in (path.states.q, path.states.p)))
    on = scene.simulate(exact, params, 200, 100)
    assert torch.allclose(on.at(1).flat, path.at(3).flat, rtol=0, atol=1e-13)


@each_kind
def test_both_systems_are_coercive_and_keep_a_degenerate_pair(kind):
    strength = torch.linalg.eigvalsh(coupling_stiffness(kind))
    assert math.isclose(float(strength[-1]), 1.5)
    assert math.isclose(float(strength[1]), float(strength[2]))
    for coupling in (-1.5, 1.5):
        assert bool((CONFINEMENT + coupling * strength > 0).all())


def test_a_coupling_that_tears_the_ring_apart_is_refused():
    scene, start, params = drawn()
    with pytest.raises(ValueError, match="not coercive"):
        scene.simulate(start, params.with_coupling(-2.0), 10)


def test_an_unknown_system_is_refused():
    with pytest.raises(InputError, match="unknown kind 'square'; use one of coupled, modified"):
        oscillators("square")


@each_kind
def test_curl_is_antisymmetric_and_of_the_size_asked_for(kind):
    push = curl_matrix(0.06, kind)
    assert torch.equal(push, -push.T)
    assert math.isclose(float(push.norm() / coupling_stiffness(kind).norm()), 0.06)


# --- candidates --------------------------------------------------------------------------------


def test_ridge_finds_the_stiffness_of_clean_labels():
    content = fit_stiffness(labels(noise=0.0), "linear")
    assert torch.allclose(content[0], coupling_stiffness("coupled"), rtol=0, atol=1e-5)
    ring = fit_ring(labels("modified", noise=0.0))
    assert torch.allclose(ring[0], coupling_stiffness("modified"), rtol=0, atol=1e-13)


def test_the_hamiltonian_is_the_orthogonal_projection_and_loses_all_curl():
    content = fit_stiffness(labels(curl=0.1, noise=0.0), "linear")
    head = candidate("hamiltonian", content, "linear", leapfrog)
    kept = head.potential.parts[0].stiffness.content
    rest = content - kept
    assert torch.equal(kept, kept.mT)
    assert abs(float((kept * rest).sum())) < 3e-15
    # What is left of the curl is the chance correlation of 400 states.
    assert torch.allclose(kept[0], coupling_stiffness("coupled"), atol=5e-3)
    # The fixed curl is fitted as best a multiple of G can: E[G] / E[G^2] of it.
    wanted = curl_matrix(0.1, "coupled") * (1 / (1 + 1 / 12))
    assert torch.allclose(rest[0], wanted, rtol=0.05, atol=1e-3)


def test_a_force_with_curl_has_no_potential():
    content = fit_stiffness(labels(curl=0.1), "linear")
    with pytest.raises(ValueError, match="not symmetric, so its force has no potential"):
        QuadraticPotential(Stiffness(content, 0.0))


@pytest.mark.parametrize("shape", [(2, 4, 4), (1, 4, 3)])
def test_a_stiffness_of_the_wrong_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"content must be \(..., 1, n, n\)"):
        Stiffness(torch.zeros(shape), 0.0)


@pytest.mark.parametrize("representation", REPRESENTATIONS)
@pytest.mark.parametrize("method", [leapfrog, rk4, implicit_midpoint])
def test_powers_of_the_step_are_the_rollout(representation, method):
    scene, start, params = drawn()
    content = fit_stiffness(labels(curl=0.1), "localised")
    head = candidate(representation, content, "localised", method)
    slow = rollout(head, start, params, 40, 0.05, 2).states
    fast = roll_linear(head, start, params, 40, 0.05, 2)
    assert torch.allclose(fast.flat, slow.flat, rtol=0, atol=1e-12)


def test_curl_pumps_energy_exponentially_at_its_exact_rate():
    """A degenerate pair of frequency w under curl a has an energy that grows as exp(a t / w)."""
    a, w2 = 0.02, 2.0
    push = torch.tensor([[0.0, -a], [a, 0.0]], dtype=torch.float64)
    field = LinearField(Stiffness(push[None], w2), rk4)
    params = Parameters(torch.ones(1).double(), torch.ones(1, 2).double())
    w = math.sqrt(w2)
    # The growing one of the two circular motions.
    start = PhaseState(
        torch.tensor([[[1.0], [0.0]]]).double(), torch.tensor([[[0.0], [-w]]]).double()
    )
    states = rollout(field, start, params, 1000, 0.05, 1000).states
    energy = 0.5 * states.p.square().sum((-2, -1)) + 0.5 * w2 * states.q.square().sum((-2, -1))
    grown = float((energy[0, 1] / energy[0, 0]).log())
    assert math.isclose(abs(grown), a * 50 / w, rel_tol=0.02)


def test_localised_features_answer_nothing_at_a_negative_coupling():
    _, start, params = drawn()
    content = fit_stiffness(labels(), "localised")
    for representation in REPRESENTATIONS:
        head = candidate(representation, content, "localised", leapfrog)
        seen = response(head, start.q, params)
        unseen = response(head, start.q, params.with_coupling(-1.0))
        assert float(unseen.abs().max()) < 1e-6 * float(seen.abs().max())


def test_a_linear_map_is_odd_in_the_coupling_bitwise():
    scene = oscillators()
    head = scene.build(terms.Hamiltonian(potentials=(terms.Mapped(),))).double()
    _, start, params = drawn()
    force = head.force(start, params)
    assert torch.equal(head.force(start, params.with_coupling(-params.coupling)), -force)


@pytest.mark.parametrize("name", [*MAPS, "gain"])
def test_mapped_forces_are_gradients(name):
    scene, start, params = drawn()
    head = scene.build(
        terms.Hamiltonian(potentials=(terms.Mapped(name), terms.Trap(CONFINEMENT)))
    ).double()
    q = start.q.clone().requires_grad_()
    (slope,) = torch.autograd.grad(head.potential.energy(q, params).sum(), q)
    assert torch.allclose(head.potential.force(q, params), -slope, rtol=0, atol=3e-15)


def test_the_study_s_parameter_count_and_the_localised_map_has_the_most():
    counts = {
        name: parameter_count(
            build(terms.Hamiltonian(potentials=(terms.Mapped(name),)), 4, 0.05, 1)
        )
        for name in ("linear", "localised")
    }
    assert counts["linear"] == 4545
    assert counts["localised"] > counts["linear"]


def test_unknown_maps_are_refused():
    with pytest.raises(ValueError, match="unknown 'odd'; known: linear, localised"):
        coupling_map("odd")


# --- tables ------------------------------------------------------------------------------------


def numbers(task):
    return {
        (row["cell"], row["metric"]): row["value"]
        for recorder in task.recorders
        for row in recorder.rows
    }


def test_the_factorial_s_pattern_holds_in_a_small_run(monkeypatch):
    monkeypatch.setattr(factorial, "SECONDS", 10.0)
    task = CellTask("factorial", "oscillators", (0,), TINY)
    FACTORIAL.cells["oscillators"](task)
    found = numbers(task)
    tests = "oscillators/tests"
    assert found[tests, "holm_p_largest"] == pytest.approx(6 * 2 / 2**12, rel=3e-15)
    assert found[tests, "energy_error_ratio_smallest"] > 3
    for kind in GROUNDED:
        near = found[f"oscillators/{kind}/hamiltonian/linear", "response_nmse"]
        far = found[f"oscillators/{kind}/hamiltonian/localised", "response_nmse"]
        assert near < 1e-3 < 0.9 < far
    for name in REPRESENTATIONS:
        assert found[f"oscillators/{name}", "escape_fraction_largest"] == 0
    raw = [r for rec in task.recorders for r in rec.episode_rows if r["metric"] == "energy_error"]
    assert {row["episode"] for row in raw} == set(range(factorial.PAIRS))


def test_seeds_repeat_themselves_and_differ_from_each_other():
    def run(*seeds):
        task = CellTask("curl", "oscillators", seeds, TINY)
        CURL_TABLE.cells["oscillators"](task)
        return [(r["seed"], r["metric"], r["value"]) for rec in task.recorders for r in rec.rows]

    both, alone = run(0, 1), run(1)
    assert [row for row in both if row[0] == 1] == alone
    zero = [row[1:] for row in both if row[0] == 0]
    assert zero != [row[1:] for row in alone]


def test_curl_hurts_the_unrestricted_field_only():
    task = CellTask("curl", "oscillators", (0,), OracleSizes(256, 4, 64, (5e-3,), 4))
    CURL_TABLE.cells["oscillators"](task)
    found = numbers(task)

    def error(representation, curl):
        return found[f"oscillators/coupled/{representation}/curl-{curl}", "energy_error"]

    assert error("unrestricted", "0.1") > 100 * error("unrestricted", "0")
    assert error("hamiltonian", "0.1") < 1.5 * error("hamiltonian", "0")


@pytest.mark.parametrize("cell", ["coupled-eight-scalars", "modified-gain", "coupled-localised"])
def test_map_families_leave_their_numbers(cell):
    task = CellTask("maps", cell, (0, 1), TINY)
    MAPS_TABLE.cells[cell](task)
    found = numbers(task)
    for metric in ("response_nmse", "fit_nmse", "response_cosine", "ballistic_skill", "parameters"):
        assert found[cell, metric] is not None
    if cell == "coupled-eight-scalars":
        assert found[cell, "response_nmse"] < 1e-4


def test_every_integrator_of_the_factorial_is_known():
    assert set(factorial.METHODS) <= set(INTEGRATORS)
