"""A wall: bounces are exact in a uniform field, lose what they should, and let nothing through."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from dynamics import (
    Hamiltonian,
    OverlapWarning,
    Parameters,
    PhaseState,
    StabilityWarning,
    build,
    rollout,
    terms,
)
from dynamics.fields import UniformField
from dynamics.kinetic import FixedKinetic
from dynamics.potentials import HarmonicTrap
from dynamics.walls import Wall, Walled
from vidphys.stress.flights import Wall as Swing
from vidphys.stress.walls import height

DOWN = (0.6, -0.8)  # a floor that is tilted, so that no axis is special
PULL = 2.0


def floor(restitution):
    """Bodies that fall on a tilted floor through the origin."""
    field = UniformField(2).double()
    with torch.no_grad():
        field.acceleration.copy_(PULL * torch.tensor(DOWN, dtype=torch.float64))
    return Walled(Hamiltonian(FixedKinetic(), field), Wall(0.0, restitution, DOWN))


def dropped(height, mass=1.5):
    """At rest, so high above the floor."""
    q = -height * torch.tensor([[DOWN]], dtype=torch.float64)
    params = Parameters(torch.ones(1).double(), torch.full((1, 1), mass).double())
    return PhaseState(q, torch.zeros_like(q)), params


def heights(path):
    return -(path.states.q[0, :, 0] @ torch.tensor(DOWN, dtype=torch.float64))


@pytest.mark.parametrize("restitution", [1.0, 0.8])
def test_a_ball_bounces_as_in_closed_form_whatever_the_step(restitution):
    start, params = dropped(1.0)
    fall = math.sqrt(2 / PULL)
    for dt in (0.0137, 0.093):
        steps = int(3 * fall * (1 + 2 * restitution) / 4 / dt)
        path = rollout(floor(restitution), start, params, steps, dt)
        t = torch.arange(steps + 1).double() * dt
        since = t - fall
        rise = restitution * PULL * fall * since - PULL * since.square() / 2
        expected = torch.where(t < fall, 1 - PULL * t.square() / 2, rise)
        assert float((heights(path) - expected).abs().max()) < 1e-13


@pytest.mark.slow
def test_a_wall_without_loss_keeps_the_energy_over_a_thousand_bounces():
    head, (start, params) = floor(1.0), dropped(1.0)
    assert head.conserves and not floor(0.9).conserves
    path = rollout(head, start, params, 40_000, 0.05, every=100)
    energy = head.energy(path.states, params).detach()
    assert float(energy[0, 0]) == pytest.approx(1.5 * PULL, rel=3e-15)  # all of it potential
    assert float((energy / energy[:, :1] - 1).abs().max()) < 1e-13
    assert float(path.states.p.abs().max()) > 1  # it still bounces


def test_a_ball_that_loses_speed_comes_to_lie_on_the_wall_and_stays():
    start, params = dropped(0.3)
    path = rollout(floor(0.5), start, params, 2000, 0.01)
    assert bool(path.finite.all())
    assert float(heights(path).min()) > -1e-12
    assert float(heights(path)[-1000:].abs().max()) < 1e-15
    assert float(path.states.p[0, -1].abs().max()) < 1e-13


def test_several_bounces_in_one_step_are_all_made():
    start, params = dropped(1.0)
    path = rollout(floor(0.3), start, params, 30, 0.1)
    expected = torch.tensor([height(0.1 * k, 0.3) for k in range(31)], dtype=torch.float64)
    assert float((heights(path) - expected).abs().max()) < 1e-14
    assert float(expected[17]) > 0.005 and float(expected[18]) < 0.001  # two bounces between


def test_only_what_goes_into_the_wall_is_turned_and_along_it_nothing_changes():
    q = torch.tensor([[[0.1, 0.5], [0.1, -0.5], [-0.2, 0.3]]], dtype=torch.float64)
    p = torch.tensor([[[1.0, 2.0], [-1.0, 2.0], [4.0, 2.0]]], dtype=torch.float64)
    wall = Wall(0.0, 0.5, (2.0, 0.0))
    mass = torch.ones(1, 3).double()
    after = wall.bounced(PhaseState(q, p), torch.zeros_like(q), mass)
    expected_q = torch.tensor([[[-0.05, 0.5], [0.1, -0.5], [-0.2, 0.3]]]).double()
    expected_p = torch.tensor([[[-0.5, 2.0], [-1.0, 2.0], [4.0, 2.0]]]).double()
    torch.testing.assert_close(after.q, expected_q)
    torch.testing.assert_close(after.p, expected_p, rtol=3e-15, atol=3e-15)


def test_a_swing_beside_a_wall_converges_to_its_closed_form():
    swing = Swing(0.3, 0.85, 16.0, -4.8, 0.0, -0.45, 0.0)
    free = Hamiltonian(FixedKinetic(), HarmonicTrap(swing.stiffness))
    head = Walled(free, Wall(swing.place, swing.restitution, (1.0,)))
    start = PhaseState(torch.full((1, 1, 1), swing.start).double(), torch.zeros(1, 1, 1).double())
    params = Parameters(torch.ones(1).double(), torch.ones(1, 1).double())
    errors = []
    for steps in (400, 1600):
        path = rollout(head, start, params, steps, 3 / steps)
        times = np.arange(steps + 1) * 3 / steps
        errors.append(np.abs(path.states.q[0, :, 0, 0].numpy() - swing.path(times)).max())
    assert errors[1] < 2e-4 and errors[1] < errors[0] / 3


def test_a_wall_is_a_term_that_a_model_has_or_has_not():
    free = terms.Hamiltonian(potentials=(terms.Trap(4.0),), ports=(terms.LinearFriction(),))
    term = terms.Walled(free, 0.5, 0.9, (1.0, 0.0))
    head = build(term, 1, 0.002)
    assert isinstance(head, Walled) and len(list(head.parameters())) == 1
    assert not isinstance(build(free, 1, 0.002), Walled)
    with pytest.raises(ValueError, match="normal must have 2 numbers"):
        build(replace(term, normal=(1.0,)), 1, 0.002)
    with pytest.raises(ValueError, match="within 0 and 1"):
        Wall(0.0, 1.2, DOWN)
    with pytest.raises(ValueError, match="point somewhere"):
        Wall(0.0, 0.9, (0.0, 0.0))


def test_who_starts_behind_a_wall_or_shakes_too_fast_is_told():
    start, params = dropped(-0.1)
    with pytest.warns(OverlapWarning, match="start behind it in 1 of 1 episodes"):
        rollout(floor(0.9), start, params, 1, 0.01)
    stiff = Walled(Hamiltonian(FixedKinetic(), HarmonicTrap(1e4)), Wall(1.0, 0.9, DOWN))
    with pytest.warns(StabilityWarning, match="HarmonicTrap"):
        rollout(stiff, *dropped(0.5), 1, 0.1)
