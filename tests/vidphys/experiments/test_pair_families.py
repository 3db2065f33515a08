"""Charges, springs, many bodies, shortcuts: scenes, heads and the cells of their tables."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator

from dynamics import HEADS, PairLaw, Parameters, PhaseState, build, rollout, terms
from dynamics.contact import CutSpring
from dynamics.hybrid import Shortcut, shortcut_of, shortcut_share
from dynamics.potentials import PIECE, DisplacementPotential, RadialPotential, SoftenedGravity
from vidphys.experiments.core.cell import CellTask
from vidphys.experiments.core.losses import floored, shortcut_penalised
from vidphys.experiments.gravity.families import COULOMB, MIXED, flip_both
from vidphys.experiments.gravity.scale import N_TRANSFER, episodes_of
from vidphys.experiments.linear.necessity import COMPOSITION, NECESSITY
from vidphys.presets import OracleSizes
from vidphys.scenes import certify, gravity
from vidphys.scenes.coulomb import all_alike, coulomb, gravity_and_coulomb, mixed_signs
from vidphys.scenes.crowd import crowd
from vidphys.scenes.springs import CUTOFF, springs
from vidphys.training.segments import Segments, scale_of

BESIDE = terms.Hamiltonian(potentials=(terms.Shortcut((terms.Displacement("alike"),)),))
TINY = OracleSizes(32, 4, 64, (5e-3,), 4)


def one(*values: float) -> torch.Tensor:
    return torch.tensor([values], dtype=torch.float64)


def draw(scene, episodes: int = 16):
    return scene.sample(episodes, Generator().manual_seed(1))


# --- scenes -----------------------------------------------------------------------------------


def test_like_charges_repel_and_unlike_ones_attract_by_the_softened_law():
    law = coulomb(2).law
    state = PhaseState(
        torch.tensor([[[0.0, 0.0], [2.0, 0.0]]]).double(), torch.zeros(1, 2, 2).double()
    )
    for second, sign in ((1.0, -1.0), (-1.0, 1.0)):
        params = Parameters(one(1.0)[0], one(1.0, 1.0), one(1.0, second), {"electric": one(1.5)[0]})
        expected = sign * 1.5 * 2.0 / (4 + 0.01) ** 1.5
        assert float(law.force(state, params)[0, 0, 0]) == pytest.approx(expected, rel=3e-15)
        energy = -sign * 1.5 / (4 + 0.01) ** 0.5
        assert float(law.energy(state, params)) == pytest.approx(energy, rel=3e-15)


def test_all_charges_alike_are_held_out_and_every_other_set_is_drawn():
    charge = mixed_signs(2000, 3, Generator().manual_seed(0))
    assert (charge.abs() == 1).all()
    sums = charge.sum(-1)
    assert set(sums.tolist()) == {-1.0, 1.0}
    _, counts = charge.unique(dim=0, return_counts=True)
    assert len(counts) == 6 and int(counts.min()) > 270 and int(counts.max()) < 400
    _, params = draw(coulomb())
    assert (all_alike(params).charge == 1).all()
    assert (params.charge.sum(-1).abs() == 1).all()


def test_flipping_both_laws_turns_the_whole_force_round():
    scene = gravity_and_coulomb()
    start, params = draw(scene)
    torch.testing.assert_close(
        scene.law.force(start, flip_both(params)),
        -scene.law.force(start, params),
        rtol=3e-15,
        atol=3e-15,
    )
    one_only = params.with_coupling(-params.coupling)
    assert not torch.allclose(scene.law.force(start, one_only), -scene.law.force(start, params))


def test_a_cut_spring_pulls_within_the_cutoff_and_not_beyond(float64):
    spring = CutSpring(CUTOFF, PairLaw("alike"))
    inside, outside = torch.tensor([[0.3, 0.4]]), torch.tensor([[0.8, 0.7]])
    torch.testing.assert_close(spring.pair_gradient(inside), inside, rtol=3e-15, atol=3e-15)
    assert (spring.pair_gradient(outside) == 0).all()
    assert float(spring.pair_energy(outside)) == 0
    # The energy is continuous at the cutoff: its integral of the force ends at zero there.
    assert float(spring.pair_energy(inside)) == pytest.approx((0.25 - 1) / 2, rel=3e-15)
    with pytest.raises(ValueError, match="cutoff must be > 0"):
        CutSpring(0.0)


@pytest.mark.parametrize("make", [coulomb, gravity_and_coulomb, springs])
def test_references_are_certified_and_keep_their_momentum(make):
    scene = make()
    start, params = draw(scene)
    path = scene.simulate(start, params, 500, 10)
    assert certify(scene, path).passed.all()
    assert float(path.states.p.sum(-2).abs().max()) < 1e-12


def test_a_crowd_is_as_dense_as_three():
    def density(n: int) -> float:
        start, _ = draw(crowd(n), 400)
        return n / float(start.q.square().mean())

    assert density(48) == pytest.approx(density(3), rel=0.1)
    assert torch.equal(draw(crowd(3))[0].q, draw(gravity())[0].q)


# --- heads ------------------------------------------------------------------------------------


def test_a_model_of_two_laws_is_odd_in_both_strengths_together():
    scene = gravity_and_coulomb()
    head = scene.build(
        terms.Hamiltonian(potentials=(terms.Displacement(), terms.Displacement("charge")))
    )
    start, params = (x.map(torch.Tensor.float) for x in draw(scene))
    assert torch.equal(head.force(start, flip_both(params)), -head.force(start, params))


@pytest.mark.parametrize("make", [DisplacementPotential, RadialPotential])
def test_forces_in_pieces_are_those_of_all_pairs_at_once(make, float64, monkeypatch):
    potential = make(2, 8, "tanh") if make is DisplacementPotential else make(8, "tanh")
    start, params = draw(crowd(20), 2)
    whole = potential.force(start.q, params), potential.energy(start.q, params)
    monkeypatch.setattr("dynamics.potentials.PIECE", 64)
    seen = []
    plain = potential.pair_gradient
    monkeypatch.setattr(potential, "pair_gradient", lambda x: seen.append(x.shape) or plain(x))
    with torch.no_grad():
        pieces = potential.force(start.q, params), potential.energy(start.q, params)
    assert len(seen) > 2 and max(2 * s[-2] for s in seen) <= 64
    for a, b in zip(whole, pieces, strict=True):
        torch.testing.assert_close(a, b, rtol=3e-15, atol=3e-15)


def test_a_thousand_bodies_need_bounded_memory(monkeypatch):
    # What a pair network is handed at once is at most PIECE pairs, of the half million there are.
    potential = RadialPotential(4, "tanh")
    start, params = (x.map(torch.Tensor.float) for x in draw(crowd(600), 1))
    rows = []
    plain = potential.pair_gradient
    monkeypatch.setattr(potential, "pair_gradient", lambda x: rows.append(x.shape[-2]) or plain(x))
    with torch.no_grad():
        potential.force(start.q, params)
    assert sum(rows) == 600 * 599 // 2 and max(rows) <= PIECE


@torch.no_grad()
def test_a_shortcut_adds_its_force_keeps_momentum_and_is_counted(float64):
    scene = springs()
    head = scene.build(BESIDE)
    start, params = draw(scene)
    part = shortcut_of(head)
    free = part.free_force(start.q, params)
    torch.testing.assert_close(
        head.force(start, params),
        part.factored.force(start.q, params) + free,
        rtol=3e-15,
        atol=3e-15,
    )
    torch.testing.assert_close(free.sum(-2), torch.zeros(16, 2), rtol=3e-15, atol=3e-15)
    assert torch.equal(part.energy(start.q, params), part.factored.energy(start.q, params))
    share = shortcut_share(head, start, params)
    assert 0 < float(share) < 1
    for parameter in part.free.layers[-1].parameters():
        parameter.zero_()
    assert float(shortcut_share(head, start, params)) == 0
    with pytest.raises(ValueError, match="has no shortcut"):
        shortcut_of(scene.build(HEADS["factored"]))


def test_a_flipped_coupling_does_not_flip_what_a_shortcut_does(float64):
    scene = springs()
    head = scene.build(BESIDE)
    start, params = draw(scene)
    flipped = params.with_coupling(-params.coupling)
    forces = head.force(start, params), head.force(start, flipped)
    assert not torch.allclose(forces[0], -forces[1], atol=1e-3)


def example(scene, head) -> Segments:
    start, params = (x.map(torch.Tensor.float) for x in draw(scene))
    after, _ = head.advance(start, params, scene.dt)
    with torch.no_grad():
        q, p = ((b - a).unsqueeze(1) for a, b in ((start.q, after.q), (start.p, after.p)))
    return Segments(start, params, q, p, scene.dt, 1)


@torch.no_grad()
def test_the_penalty_grows_with_its_weight_and_the_floor_lowers_the_loss():
    scene = springs()
    torch.manual_seed(0)
    head = scene.build(BESIDE)
    batch = example(scene, head)
    scale = scale_of(batch)
    assert float(shortcut_penalised(0.0, 0.1)(head, batch, scale)) == 0
    one_, two = (float(shortcut_penalised(w, 0.1)(head, batch, scale)) for w in (1.0, 2.0))
    assert one_ > 0 and two == 2 * one_
    wrong = replace(batch, p=2 * batch.p)
    low, high = (float(floored(s)(head, wrong, scale)) for s in (1.0, 0.0))
    assert low < high


def test_increments_of_bodies_without_force_do_not_set_the_scale():
    scene = springs()
    batch = example(
        scene, scene.build(terms.Hamiltonian(potentials=(terms.Displacement("alike"),)))
    )
    still = replace(batch, p=torch.cat([batch.p[:4], torch.zeros_like(batch.p[4:])]))
    assert scale_of(still).p_small > 0
    assert scale_of(replace(batch, p=torch.zeros_like(batch.p))).p == 1.0


# --- tables -----------------------------------------------------------------------------------


def test_fewer_episodes_where_there_are_more_bodies():
    assert episodes_of(3, 32) == 32
    assert episodes_of(32, 32) == 3
    assert episodes_of(1024, 32) == 1


@pytest.mark.parametrize(
    ("table", "cell", "metric"),
    [
        (COULOMB, "factored-radial", "inversion_nmse"),
        (MIXED, "factored-radial", "force_cosine"),
        (NECESSITY, "one-stiffness/free", "shortcut_share"),
        (COMPOSITION, "port-and-penalty", "shed_error"),
    ],
)
def test_cells_leave_their_records_for_each_seed(table, cell, metric, monkeypatch):
    tables = "vidphys.experiments"
    monkeypatch.setattr("vidphys.experiments.core.oracle.OLDEST", 100)
    for name in ("gravity.families", "linear.necessity"):
        monkeypatch.setattr(f"{tables}.{name}.DRIFT_STEPS", (10, 20))
    monkeypatch.setattr(f"{tables}.linear.necessity.STEPS", 20)
    task = CellTask(table.name, cell, (0, 1), TINY)
    table.cells[cell](task)
    for seed in (0, 1):
        rows = [r for rec in task.recorders for r in rec.rows if r["seed"] == seed]
        assert any(r["metric"] == metric and r["value"] is not None for r in rows)


def test_models_of_three_bodies_are_asked_about_more(monkeypatch):
    monkeypatch.setattr("vidphys.experiments.core.oracle.OLDEST", 100)
    monkeypatch.setattr("vidphys.experiments.gravity.scale.LONG", (3, 5))
    monkeypatch.setattr("vidphys.experiments.gravity.scale.CURVE", (40,))
    monkeypatch.setattr("vidphys.experiments.gravity.scale.LONG_STEPS", 20)
    task = CellTask("n-transfer", "factored-radial", (0,), TINY)
    N_TRANSFER.cells["factored-radial"](task)
    rows = [r for rec in task.recorders for r in rec.rows]
    drifts = {r["cell"]: r["horizon"] for r in rows if r["metric"] == "energy_drift_median"}
    assert drifts == {"factored-radial/3": 20, "factored-radial/5": 20, "factored-radial/40": 5}


def test_a_pair_law_learned_for_three_is_the_law_of_many():
    # With the true pair function, more bodies are exactly the larger scene.
    scene = crowd(12)
    start, params = draw(scene, 2)
    head = build(HEADS["factored"], 3, scene.dt)
    head.potential = SoftenedGravity(0.1)
    ours = rollout(head, start, params, 20, scene.dt).states
    torch.testing.assert_close(
        ours.q, scene.simulate(start, params, 20).states.q, rtol=3e-15, atol=3e-15
    )


@torch.no_grad()
def test_a_shortcut_does_not_see_where_the_scene_is():
    torch.manual_seed(0)
    law, q = Shortcut(SoftenedGravity(0.1), 2, 8).double(), torch.randn(3, 2).double()
    params = Parameters(torch.ones(()).double(), torch.ones(3).double())
    # Drawn in single precision, so that the sum with 5 is exact.
    assert torch.equal(law.free_force(q + 5.0, params), law.free_force(q, params))
