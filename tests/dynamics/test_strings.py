"""Strings that go slack: they keep, let go and catch as the equations say."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynamics import OverlapWarning, Parameters, PhaseState, build, rollout, terms
from vidphys.testing.heads import check_head

G, LENGTH, CENTRE = 9.81, 0.8, np.array([0.1, 0.2])


def hung(rate=None, **changes):
    ports = () if rate is None else (terms.Drag(rate=rate),)
    free = terms.Hamiltonian(potentials=(terms.Uniform((0.0, -G)),), ports=ports)
    asked = {"centre": tuple(CENTRE.tolist()), "length": LENGTH, "learned": False, **changes}
    return build(terms.Strung(free.throughout(learned=False), **asked), 1, 0.01).double()


def let_go(place, velocity, mass=1.7):
    q, v = (torch.from_numpy(np.array([[x]])) for x in (place, velocity))
    return PhaseState(q, mass * v), Parameters(
        torch.ones(1).double(), torch.full((1, 1), mass, dtype=torch.float64)
    )


def places(head, start, params, steps, dt, every=1):
    path = rollout(head, start, params, steps, dt, every)
    return path.states.q[0, :, 0].detach().numpy() - CENTRE, path


@pytest.mark.parametrize("rate", [None, pytest.param(0.3, marks=pytest.mark.slow)])
def test_while_it_is_taut_it_is_a_pendulum(rate):
    angle, mass = 1.2, 1.7
    start, params = let_go(CENTRE + LENGTH * np.array([np.sin(angle), -np.cos(angle)]), [0.0, 0.0])
    found, path = places(hung(rate), start, params, 1000, 0.001, 50)
    friction = (rate or 0.0) / mass
    s = solve_ivp(
        lambda _, x: [x[1], -G / LENGTH * np.sin(x[0]) - friction * x[1]],
        (0, 1.0),
        [angle, 0.0],
        t_eval=path.times.numpy(),
        rtol=1e-10,
        atol=1e-12,
    ).y[0]
    expected = LENGTH * np.stack([np.sin(s), -np.cos(s)], -1)
    assert np.abs(found - expected).max() < 1e-5


def test_a_weight_that_falls_is_caught_and_loses_what_goes_along_the_string():
    start, params = let_go(CENTRE + [0.5, 0.3], [0.0, 0.0])
    head = hung()
    met = np.array([0.5, -np.sqrt(LENGTH**2 - 0.25)])
    when = np.sqrt(2 * (0.3 - met[1]) / G)
    speed = G * when
    left = speed * 0.5 / LENGTH  # across the string
    for dt in (0.0131, 0.004):
        steps = int(when / dt) + 1
        found, path = places(head, start, params, steps, dt)
        times = path.times.numpy()
        flown = 0.3 - G * times[:-1] ** 2 / 2
        assert found[:-1, 1] == pytest.approx(flown, abs=1e-12)
        energy = head.energy(path.states, params)[0, -1].item() / 1.7
        assert energy == pytest.approx(left**2 / 2 + G * (met[1] + CENTRE[1]), rel=2e-3)
        assert np.linalg.norm(found[-1]) == pytest.approx(LENGTH, abs=1e-7)


def test_a_weight_that_is_thrown_up_is_stopped_and_falls_from_there():
    speed = 5.0
    start, params = let_go(CENTRE, [0.0, speed])
    left = np.sqrt(speed**2 - 2 * G * LENGTH)  # as the string takes it
    when = (speed - left) / G
    found, path = places(hung(), start, params, 50, 0.0117)
    since = path.times.numpy() - when
    expected = LENGTH - G * since**2 / 2 + np.where(since < 0, left * since, 0)
    assert found[:, 0] == pytest.approx(0.0, abs=1e-12)
    assert found[:, 1] == pytest.approx(expected, abs=1e-8)


def test_it_keeps_its_energy_round_and_round_and_nothing_is_ever_beyond_its_end():
    head, (start, params) = hung(), let_go(CENTRE - [0.0, LENGTH], [7.0, 0.0])
    found, path = places(head, start, params, 1000, 0.005, 20)
    assert np.abs(np.linalg.norm(found, axis=1) - LENGTH).max() < 1e-7
    energy = head.energy(path.states, params)[0].detach().numpy()
    assert np.ptp(energy) < 2e-3 * 1.7 * 7.0**2


def test_it_lets_go_where_it_would_have_to_push():
    """With a squared speed of 3.5 g l at the bottom, at a height of l / 2 over the centre."""
    head = hung()
    start, params = let_go(CENTRE - [0.0, LENGTH], [np.sqrt(3.5 * G * LENGTH), 0.0])
    found, _ = places(head, start, params, 1000, 0.0005)
    slack = np.linalg.norm(found, axis=1) < LENGTH - 1e-6
    first = slack.argmax()
    assert found[first, 1] == pytest.approx(LENGTH / 2, abs=0.01)
    fallen = np.diff(found[first : first + 50, 1], 2) / 0.0005**2
    assert fallen == pytest.approx(-G, rel=1e-6)


@pytest.mark.slow
def test_its_length_is_learned_through_what_is_seen():
    truth, head = hung(), hung(length=0.75, learned=True)
    start, params = let_go(CENTRE + [0.5, 0.3], [0.4, 0.0])
    target = truth.trajectory(start, params, 60, 0.01, 3).states.q.detach()
    optimiser = torch.optim.Adam([head.length], 0.01)
    for _ in range(30):
        optimiser.zero_grad()
        found = head.trajectory(start, params, 60, 0.01, 3).states.q
        (found - target).square().sum().backward()
        optimiser.step()
    assert head.length.item() == pytest.approx(LENGTH, rel=0.01)


def test_it_keeps_every_contract_of_a_head():
    torch.manual_seed(1)
    angle = torch.rand(4, 1, dtype=torch.float64)  # nearly at the end, which is then met
    out = torch.stack([angle.sin(), -angle.cos()], -1)
    q, v = 0.999 * LENGTH * out + torch.tensor(CENTRE), 2.0 * out
    mass = torch.linspace(0.6, 1.4, 4).double()[:, None]
    law = Parameters(torch.ones(4).double(), mass)
    check_head(hung(0.2, learned=True).float(), 1, 2, law, PhaseState(q, mass[..., None] * v))


def test_what_cannot_be_is_refused_or_told():
    with pytest.raises(ValueError, match="length must be > 0"):
        hung(length=0.0)
    with pytest.raises(ValueError, match="centre must have 2 numbers"):
        hung(centre=(0.0,))
    with pytest.warns(OverlapWarning, match="beyond a string's end in 1 of 1 episodes"):
        rollout(hung(), *let_go(CENTRE + [2.0, 0.0], [0.0, 0.0]), 1, 0.01)
