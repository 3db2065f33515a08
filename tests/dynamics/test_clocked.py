"""Laws that change with time, against closed forms."""

import math

import pytest
import torch

from dynamics import Parameters, PhaseState, build, rollout, terms

SWING = terms.Hamiltonian(potentials=(terms.Trap(4.0),))
FREE = terms.Hamiltonian(potentials=(terms.NoPotential(),))
MOTOR = terms.Sinusoid((0.7,), (-0.4,), 3.1, learned=False)
LAW = Parameters(torch.ones(1).double(), torch.full((1, 1), 2.0).double())
STEPS = 400


def told(clock: float) -> Parameters:
    return LAW.with_scalar("clock", clock)


def at_rest(space: int = 1) -> PhaseState:
    return PhaseState(*torch.zeros(2, 1, 1, space, dtype=torch.float64))


def path(term, start, law, steps=STEPS, dt=0.01, space=1):
    head = build(term, 1, dt, space).double().requires_grad_(False)
    return rollout(head, start, law, steps, dt).states


def driven(times):
    """From rest at 0.3 s: what the motor makes of the swing, by the formula for resonance."""
    swing, rate = 2.0, 3.1
    gain = 1 / (swing**2 - rate**2)

    def forced(t):
        return gain * (0.7 * torch.cos(rate * t) - 0.4 * torch.sin(rate * t))

    def slope(t):
        return gain * rate * (-0.7 * torch.sin(rate * t) - 0.4 * torch.cos(rate * t))

    since, begin = swing * (times - 0.3), torch.tensor(0.3, dtype=torch.float64)
    own = forced(begin) * torch.cos(since) + slope(begin) / swing * torch.sin(since)
    return forced(times) - own


@pytest.mark.parametrize("dt", [0.02, 0.01])
def test_a_swing_that_a_motor_drives_is_the_closed_form_to_second_order(dt):
    trap = terms.Hamiltonian(potentials=(terms.Trap(8.0),))  # of a mass of two: a rate of 2
    term = terms.Clocked(trap, (MOTOR,))
    found = path(term, at_rest(), told(0.3), round(4 / dt), dt).q[0, :, 0, 0]
    times = 0.3 + dt * torch.arange(len(found), dtype=torch.float64)
    assert float((found - driven(times)).abs().max()) < 0.5 * dt**2
    assert float(found.abs().max()) > 0.1


def test_a_lift_turns_what_flies_by_less_and_less():
    start = PhaseState(torch.zeros(1, 1, 2).double(), torch.tensor([[[2.0, 0.0]]]).double())
    law = told(0.5)
    lift = terms.Clocked(FREE, (terms.Lift(1.5, 0.8, learned=False),))
    p = path(lift, start, law, 200, 0.01, 2).p[0, -1, 0]
    angle = 1.5 / 0.8 * (math.exp(-0.4) - math.exp(-0.8 * 2.5))
    expected = 2.0 * torch.tensor([math.cos(angle), math.sin(angle)], dtype=torch.float64)
    torch.testing.assert_close(p, expected, rtol=0, atol=1e-12)


def test_a_lift_that_does_not_fade_is_a_turning():
    start = PhaseState(torch.zeros(1, 1, 2).double(), torch.tensor([[[2.0, 1.0]]]).double())
    lift = path(terms.Clocked(FREE, (terms.Lift(1.5, 0.0),)), start, told(3.0), space=2)
    steady = terms.Hamiltonian(potentials=FREE.potentials, ports=(terms.Turning((1.5,)),))
    torch.testing.assert_close(lift.q, path(steady, start, LAW, space=2).q, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("term", "space"),
    [
        (terms.Clocked(SWING, (MOTOR,)), 1),
        (terms.OnLine((0.0, 1.0), (1.0, 0.5), terms.Clocked(SWING, (MOTOR,))), 2),
        (terms.Each((terms.Clocked(SWING, (MOTOR,)),)), 1),
    ],
)
def test_the_clock_goes_on_step_by_step_and_where_a_rollout_is_taken_up_again(term, space):
    start = at_rest(space)
    start = PhaseState(start.q + torch.tensor([0.0, 1.0])[:space], start.p)
    whole = path(term, start, told(0.2), space=space)
    half = PhaseState(whole.q[:, 150], whole.p[:, 150])
    rest = path(term, half, told(0.2).later(1.5), STEPS - 150, space=space)
    torch.testing.assert_close(rest.q, whole.q[:, 150:], rtol=0, atol=1e-9)
    still = path(term, half, told(0.2), STEPS - 150, space=space)
    assert float((still.q - whole.q[:, 150:]).abs().max()) > 0.01
    head, memory, state = build(term, 1, 0.01, space).double(), None, start
    for _ in range(20):
        state, memory = head.advance(state, told(0.2), 0.01, memory)
    torch.testing.assert_close(state.q, whole.q[:, 20], rtol=0, atol=1e-9)


def test_without_a_clock_it_is_refused_and_other_laws_have_none():
    head = build(terms.Clocked(SWING, (MOTOR,)), 1, 0.01, 1).double()
    with pytest.raises(ValueError, match="say what the clock shows"):
        rollout(head, at_rest(), LAW, 10, 0.01)
    assert LAW.later(3.0) is LAW
    assert not head.conserves
    with pytest.raises(ValueError, match="along must have 2 numbers"):
        build(terms.Clocked(FREE, (MOTOR,)), 1, 0.01, 2)
    with pytest.raises(ValueError, match="acts in the plane"):
        build(terms.Clocked(FREE, (terms.Lift(1.0, 0.1),)), 1, 0.01, 3)
