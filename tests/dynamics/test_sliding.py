"""Bodies on curves under a field, with dry friction by what presses them."""

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynamics import Parameters, PhaseState, build, rollout, terms

G = 9.81
PARABOLA = tuple((x / 10, (x / 10) ** 2) for x in range(-15, 16))
SLOPE = 0.3  # radians, down to the right


def one(mass=1.0):
    return Parameters(torch.ones(1).double(), torch.full((1, 1), mass).double())


def falling(coefficient=None):
    free = terms.Hamiltonian(potentials=(terms.Along((0.0, -G)),))
    return free if coefficient is None else terms.Rubbed(free, coefficient)


def on_slope(coefficient, learned=True):
    rail = (0.0, 1.0), (np.cos(SLOPE), -np.sin(SLOPE))
    term = terms.OnLine(*rail, falling(coefficient)).throughout(learned=learned)
    return build(term, 1, 0.01).double()


def started(head, s, rate, params):
    inside = PhaseState(torch.full((1, 1, 1), s).double(), torch.full((1, 1, 1), rate).double())
    inside = PhaseState(inside.q, inside.p * params.mass[..., None])
    return head.outward(inside, params.mass)


def rolled(head, start, params, steps, dt, every=1):
    path = rollout(head, start, params, steps, dt, every)
    return head.curve.coordinate(path.states.q[0])[:, 0, 0].detach().numpy(), path


def bead(coefficient, times, x0):
    """Lengths along y = x^2 from its middle, of a bead that is let go at ``x0``."""

    def slope(_, state):
        x, rate = state
        long = np.hypot(1, 2 * x)
        pressed = abs(2 / long**3 * (long * rate) ** 2 + G / long)
        along = -2 * x * G / long - coefficient * pressed * np.tanh(long * rate / 1e-5)
        return [rate, (along - 4 * x / long * rate**2) / long]

    kwargs = {"t_eval": times, "method": "LSODA", "rtol": 1e-9, "atol": 1e-11}
    x = solve_ivp(slope, (0, times[-1]), [x0, 0.0], **kwargs).y[0]
    return (x * np.hypot(1, 2 * x) + np.arcsinh(2 * x) / 2) / 2


@pytest.mark.parametrize(("coefficient", "off"), [(None, 2e-4), (0.1, 2e-3)])
def test_a_bead_in_a_parabola_moves_as_the_equation_says(coefficient, off):
    head, params = build(terms.OnCurve(PARABOLA, falling(coefficient)), 1, 0.01).double(), one(2.0)
    middle = head.curve.coordinate(torch.zeros(1, 1, 2).double()).item()
    start = PhaseState(torch.tensor([[[-1.0, 1.0]]]).double(), torch.zeros(1, 1, 2).double())
    found, path = rolled(head, start, params, 800, 0.005, 10)
    expected = bead(coefficient or 0.0, path.times.numpy(), -1.0)
    assert np.abs(found - middle - expected).max() < off
    energy = head.energy(path.states, params)[0].detach().numpy()
    if coefficient is None:
        assert head.conserves and np.ptp(energy) < 1e-3 * 2.0 * G
    else:
        assert not head.conserves and (np.diff(energy) < 1e-4).all()


@pytest.mark.parametrize("rate", [1.5, -1.5])
def test_a_block_on_a_slope_slows_by_its_weight_s_share_across(rate):
    head, params = on_slope(0.4, learned=False), one(3.0)
    found, path = rolled(head, started(head, 0.0, rate, params), params, 20, 0.01)
    pull = G * (np.sin(SLOPE) - 0.4 * np.cos(SLOPE) * np.sign(rate))
    times = path.times.numpy()
    assert found == pytest.approx(rate * times + pull * times**2 / 2, abs=1e-12)


@pytest.mark.parametrize(("coefficient", "rests"), [(0.32, True), (0.30, False)])
def test_friction_holds_a_block_on_a_slope_that_is_not_too_steep(coefficient, rests):
    """The tangent of the slope is 0.309."""
    head, params = on_slope(coefficient), one()
    found, _ = rolled(head, started(head, 0.0, -0.5, params), params, 2000, 0.01)
    assert (np.ptp(found[-1000:]) == 0) == rests
    assert rests == (found[-1] < 0)


@pytest.mark.slow
def test_its_coefficient_is_learned_through_what_is_seen():
    truth, head, params = on_slope(0.2), on_slope(0.1), one()
    start = started(truth, 0.0, 1.0, params)
    target = truth.trajectory(start, params, 40, 0.01, 10).states.q.detach()
    optimiser = torch.optim.Adam([head.law.coefficient], 0.02)
    for _ in range(60):
        optimiser.zero_grad()
        found = head.trajectory(start, params, 40, 0.01, 10).states.q
        (found - target).square().sum().backward()
        optimiser.step()
    assert head.law.coefficient.item() == pytest.approx(0.2, abs=5e-3)


@pytest.mark.parametrize(
    ("term", "words"),
    [
        (falling(), "is of bodies on a line or a drawn curve"),
        (terms.OnArc((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), falling()), "use Uniform for others"),
        (terms.OnLine((0.0,) * 3, (1.0,) * 3, falling()), "acceleration must have 3 numbers"),
        (terms.OnCurve(PARABOLA, falling(-0.1)), "coefficient must be >= 0"),
        (
            terms.OnCurve(PARABOLA, terms.Rubbed(terms.Hamiltonian(), 0.1)),
            "needs a potential Along",
        ),
    ],
)
def test_what_fits_no_curve_is_refused(term, words):
    with pytest.raises(ValueError, match=words):
        build(term, 1, 0.01)
