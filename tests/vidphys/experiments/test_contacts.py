"""Disks that touch: soft contacts, events, impulses, and the cells of the contact table."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Generator

from dynamics import HEADS, PairLaw, Parameters, PhaseState, rollout
from dynamics.contact import FreeImpulse, ImpulsePort, KnotPotential, Restitution, SoftContact
from dynamics.events import HardDisks, bounce
from vidphys.errors import InputError
from vidphys.experiments.contacts.table import CONTACTS, aged_question
from vidphys.experiments.contacts.training import (
    colliding_pair,
    collision_loss,
    stretches,
)
from vidphys.experiments.core.cell import CellTask
from vidphys.presets import OracleSizes
from vidphys.scenes import certify
from vidphys.scenes.torus import BOX, DIAMETER, LEVELS, disks, touching
from vidphys.training.segments import scale_of

TINY = OracleSizes(32, 4, 64, (5e-3,), 4)


def pair(apart: float, speed: float, masses: tuple[float, float] = (1.0, 1.0), aside: float = 0.0):
    """Two disks on a line that approach with a relative speed in their centre of mass."""
    m = torch.tensor([masses], dtype=torch.float64)
    q = torch.tensor([[[1.0, 1.0], [1.0 + apart, 1.0 + aside]]], dtype=torch.float64)
    reduced = masses[0] * masses[1] / sum(masses)
    p = torch.tensor([[[reduced * speed, 0.0], [-reduced * speed, 0.0]]], dtype=torch.float64)
    return PhaseState(q, p), Parameters(torch.ones(1, dtype=torch.float64), m)


def draw(level: str, episodes: int = 16):
    scene = disks(level)
    return scene, *scene.sample(episodes, Generator().manual_seed(1))


# --- soft contacts ----------------------------------------------------------------------------


def test_a_soft_contact_is_half_an_oscillation(float64):
    # In touch, the distance obeys mu r'' = k (diameter - r): half a period, then they part.
    k, speed = 30.0, 1.0
    state, params = pair(DIAMETER, speed)
    scene = disks("soft", bodies=2)
    duration = math.pi / math.sqrt(2 * k)
    steps = round(duration / scene.dt)
    after = rollout(scene.law, state, params.with_coupling(k), steps, scene.dt)
    torch.testing.assert_close(after.at(-1).p, -state.p, atol=2e-4, rtol=0)
    deepest = float((after.states.q[0, :, 1] - after.states.q[0, :, 0]).norm(dim=-1).min())
    assert deepest == pytest.approx(DIAMETER - speed / math.sqrt(2 * k), rel=1e-4)


def test_disks_touch_across_the_border_of_the_box():
    state, params = pair(BOX - 0.5, 0.0)
    assert touching(state.q).all()
    law = disks("soft", bodies=2).law
    force = law.force(state, params.with_coupling(30.0))
    assert float(force[0, 0, 0]) == pytest.approx(30 * 0.1, rel=3e-15)
    shifted = PhaseState(state.q + BOX, state.p)
    torch.testing.assert_close(
        law.force(shifted, params.with_coupling(30.0)), force, rtol=3e-15, atol=3e-15
    )


@given(st.floats(0.05, 1.4), st.floats(0, 2 * math.pi))
def test_a_knots_force_is_its_energys_slope_and_zero_beyond_reach(r, angle):
    torch.manual_seed(3)
    potential = KnotPotential(8, 1.0, PairLaw("alike")).double()
    direction = torch.tensor([math.cos(angle), math.sin(angle)], dtype=torch.float64)
    x = (r * direction).requires_grad_()
    (slope,) = torch.autograd.grad(potential.pair_energy(x), x)
    torch.testing.assert_close(potential.pair_gradient(x), slope, rtol=3e-15, atol=3e-15)
    if r > 1:
        assert (potential.pair_gradient(x) == 0).all()


def test_one_knot_is_a_soft_contact(float64):
    knots, contact = KnotPotential(1, DIAMETER), SoftContact(DIAMETER)
    with torch.no_grad():
        knots.sizes.fill_(1.0)
    x = torch.randn(50, 2) * 0.5
    torch.testing.assert_close(knots.pair_energy(x), contact.pair_energy(x), rtol=3e-15, atol=3e-15)
    torch.testing.assert_close(
        knots.pair_gradient(x), contact.pair_gradient(x), rtol=3e-15, atol=3e-15
    )


def test_disks_are_drawn_apart_and_in_the_box():
    _, start, _ = draw("soft", 50)  # of which some are drawn again
    assert not touching(start.q).any()
    assert float(start.q.min()) >= 0 and float(start.q.max()) <= BOX


@pytest.mark.parametrize("level", LEVELS)
def test_references_are_certified_start_apart_and_keep_their_momentum(level):
    scene, start, params = draw(level, 8)
    assert not touching(start.q).any()
    path = scene.simulate(start, params, 1000, 10)
    assert certify(scene, path).passed.all()
    assert float(path.states.p.sum(-2).abs().max()) < 1e-13
    # Something happened: at least half of the episodes saw a contact.
    assert ((path.states.p[:, -1] - path.states.p[:, 0]).abs().amax((-2, -1)) > 0).sum() >= 4


def test_overlapping_hard_disks_are_not_certified():
    scene, start, params = draw("impulsive", 4)
    path = scene.simulate(start, params, 10)
    path.states.q[1, -1, 0] = path.states.q[1, -1, 1] + 0.3
    assert certify(scene, path).passed.tolist() == [True, False, True, True]


def test_unknown_level_and_a_full_box_are_named():
    with pytest.raises(InputError, match="soft, stiff, impulsive"):
        disks("hard")
    with pytest.raises(InputError, match="no room for 60 disks"):
        disks("soft", bodies=60).sample(1, Generator().manual_seed(0))


# --- events -----------------------------------------------------------------------------------


@given(st.tuples(st.floats(0.5, 2), st.floats(0.5, 2)), st.floats(0.5, 3), st.floats(-0.55, 0.55))
def test_a_bounce_is_the_exact_one(masses, speed, aside):
    state, params = pair(1.0, speed, masses, aside)
    head = HardDisks(BOX, DIAMETER)
    after, _ = head.advance(state, params, 0.9 / speed)
    # They touch where the distance along the flight is that of the impact parameter.
    along = math.sqrt(DIAMETER**2 - aside**2)
    flight = (1.0 - along) / speed
    normal = torch.tensor([-along, -aside], dtype=torch.float64) / DIAMETER
    reduced = masses[0] * masses[1] / sum(masses)
    turned = state.p[0, 0] - 2 * normal * (state.p[0, 0] @ normal)
    torch.testing.assert_close(after.p[0, 0], turned, atol=1e-14, rtol=0)
    torch.testing.assert_close(after.p[0, 1], -turned, atol=1e-14, rtol=0)
    left = 0.9 / speed - flight
    expected = state.q[0, 0] + (state.p[0, 0] * flight + turned * left) / masses[0]
    torch.testing.assert_close(after.q[0, 0], expected, atol=1e-14, rtol=0)
    assert reduced > 0


def test_events_keep_energy_and_momentum_to_rounding_and_run_backwards():
    scene, start, params = draw("impulsive", 8)
    law = scene.law
    there = scene.simulate(start, params, 1500, 1500).at(-1)
    energies = law.energy(start, params), law.energy(there, params)
    torch.testing.assert_close(energies[0], energies[1], rtol=1e-14, atol=0)
    assert bool((energies[0] > 0).all())
    back = scene.simulate(there.reversed, params, 1500, 1500).at(-1)
    torch.testing.assert_close(back.q, start.q, atol=1e-12, rtol=0)


def test_events_do_not_depend_on_the_step():
    # Four seconds at once cross the box, where another image of a disk is the nearest one.
    scene, start, params = draw("impulsive", 8)
    fine = scene.simulate(start, params, 2000, 10).at(-1)
    coarse = scene.simulate(start, params, 2000, 2000).at(-1)
    torch.testing.assert_close(fine.q, coarse.q, atol=1e-10, rtol=0)
    torch.testing.assert_close(fine.p, coarse.p, atol=1e-9, rtol=0)


def test_hard_disks_refuse_what_has_no_meaning():
    with pytest.raises(ValueError, match="0 < diameter < box / 2"):
        HardDisks(4.0, 2.5)
    state, params = pair(1.0, 1.0)
    with pytest.raises(ValueError, match="reverse the momenta"):
        HardDisks(BOX, DIAMETER).advance(state, params, -0.1)


# --- impulses ---------------------------------------------------------------------------------


class Constant(ImpulsePort):
    """The bare port: every pair gets the same impulse."""

    def impulse(self, r, approach, slide, mass):
        return torch.full_like(r, 0.3)


@pytest.mark.parametrize("make", [Constant, Restitution, FreeImpulse])
def test_impulses_act_along_the_line_and_keep_momentum(make, float64):
    _, start, params = draw("soft")
    port = make(BOX)
    after = port.kick(start, params, 0.01)
    torch.testing.assert_close(after.sum(-2), start.p.sum(-2), rtol=1e-14, atol=1e-14)
    # Impulses along the lines between bodies also keep the angular momentum of a lone pair.
    state, two = pair(0.5, 1.0, aside=0.1)
    gained = port.kick(state, two, 0.01) - state.p
    line = state.q[:, 1] - state.q[:, 0]
    cross = gained[:, 0, 0] * line[:, 1] - gained[:, 0, 1] * line[:, 0]
    torch.testing.assert_close(cross, torch.zeros(1), rtol=3e-15, atol=3e-15)


class AsItSlides(ImpulsePort):
    """Impulses as large as the speed across the line."""

    def impulse(self, r, approach, slide, mass):
        return slide


def test_the_sliding_speed_is_across_the_line_between_bodies():
    state, params = pair(0.5, 2.0, aside=0.5)  # the line is halfway between the axes
    gained = (AsItSlides(BOX).kick(state, params, 0.01) - state.p)[0, 0]
    assert gained.norm().item() == pytest.approx(2.0 * math.sin(math.pi / 4), rel=3e-15)


@torch.no_grad()
def test_a_positive_impulse_pushes_bodies_apart():
    port, (state, params) = FreeImpulse(BOX, 4).double(), pair(0.5, 2.0)
    port.network.layers[-1].weight.zero_()
    port.network.layers[-1].bias.fill_(1.0)
    gained = port.kick(state, params, 0.01) - state.p
    expected = torch.tensor([-0.5, 0.5]).double()
    torch.testing.assert_close(gained[0, :, 0], expected, rtol=3e-15, atol=3e-15)


def test_bodies_that_do_not_touch_do_not_bounce():
    state, params = pair(1.0, 2.0)
    assert torch.equal(Restitution(BOX).kick(state, params, 0.01), state.p)


@torch.no_grad()
def test_full_restitution_is_the_elastic_bounce_and_parting_bodies_are_left_alone(float64):
    port = Restitution(BOX)
    port.raw.fill_(40.0)
    port.distance.fill_(1.0)
    state, params = pair(0.5, 1.0, (1.0, 2.0))
    push = bounce(
        state.q[:, 0] - state.q[:, 1],
        torch.tensor([[1.0, 0.0]]),
        params.mass[:, :1],
        params.mass[:, 1:],
    )
    after = port.kick(state, params, 0.01)
    torch.testing.assert_close(after[:, 0] - state.p[:, 0], push, rtol=3e-15, atol=3e-15)
    torch.testing.assert_close(
        port.kick(state.reversed, params, 0.01), state.reversed.p, rtol=3e-15, atol=3e-15
    )


# --- training ---------------------------------------------------------------------------------


def test_stretches_hold_one_collision_each_and_the_loss_vanishes_at_the_truth():
    scene = disks("impulsive")
    found = stretches(scene, 256, 0)
    assert colliding_pair(found.train.p[:, 0]).sum(-1).eq(1).all()
    assert found.train.dt == scene.dt and found.train.every == 20
    scale = scale_of(found.train)
    losses = {d: collision_loss(HardDisks(BOX, d), found.train, scale) for d in (0.5, 0.6, 0.9)}
    assert float(losses[DIAMETER]) < 1e-9
    assert float(losses[0.5]) > 0.1 and float(losses[0.9]) > 1


def test_the_diameter_has_a_gradient_towards_the_truth_from_far_off():
    scene = disks("impulsive")
    found = stretches(scene, 256, 0)
    scale = scale_of(found.train)
    for diameter, sign in ((1.6, 1), (0.7, 1), (0.58, -1)):
        head = HardDisks(BOX, diameter, learned=True)
        collision_loss(head, found.train, scale).backward()
        assert float(head.raw_diameter.grad) * sign > 0


def test_too_few_collisions_are_named():
    scene = disks("impulsive", bodies=2)
    with pytest.raises(ValueError, match="use more trajectories"):
        stretches(scene, 2, 0)
    with pytest.raises(TypeError, match="needs HardDisks"):
        collision_loss(scene.build(HEADS["factored"]), None, None)


# --- table ------------------------------------------------------------------------------------


def test_questions_about_contacts_start_in_contact_too():
    question = aged_question(disks("soft"), 32, 0)
    assert 2 < int(touching(question.start.q).sum()) < 30


def shorten(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rollouts of a few steps, from training data of no great age."""
    tables = "vidphys.experiments.contacts.table"
    monkeypatch.setattr(f"{tables}.RETRACE_STEPS", 20)
    monkeypatch.setattr(f"{tables}.DRIFT_STEPS", (10, 20))
    monkeypatch.setattr(f"{tables}.OLDEST", 100)
    monkeypatch.setattr("vidphys.experiments.core.oracle.OLDEST", 100)


@pytest.mark.parametrize(
    ("cell", "metric"),
    [
        ("soft/factored", "force_cosine"),
        ("stiff/restitution", "retrace_nmse"),
        ("impulsive/events", "diameter"),
        ("impulsive/free-impulse", "in_distribution_skill"),
    ],
)
def test_cells_leave_their_records_for_each_seed(cell, metric, monkeypatch):
    shorten(monkeypatch)
    sizes = replace(TINY, trajectories=512) if cell == "impulsive/events" else TINY
    task = CellTask("contacts", cell, (0, 1), sizes)
    CONTACTS.cells[cell](task)
    for seed in (0, 1):
        rows = [r for rec in task.recorders for r in rec.rows if r["seed"] == seed]
        assert any(r["metric"] == metric and r["value"] is not None for r in rows)


def test_hard_disks_have_no_stiffness_to_flip(monkeypatch):
    shorten(monkeypatch)
    task = CellTask("contacts", "impulsive/events", (0,), replace(TINY, trajectories=512))
    CONTACTS.cells["impulsive/events"](task)
    flipped = [r for r in task.recorders[0].rows if r["metric"] == "inversion_nmse"]
    assert [(r["status"], r["value"]) for r in flipped] == [("undefined", None)]
