"""Bodies on lines, arcs, curves and chains move as the equations of motion say, in the picture."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from dynamics import Parameters, PhaseState, build, rollout, terms
from dynamics.curves import Arc, Drawn, Line
from vidphys.testing.heads import check_head

PIVOT, ACROSS, DOWN = (0.3, 1.0), (0.5, 0.1), (0.08, -0.6)  # a circle as a tilted camera sees it
SWING = terms.Hamiltonian(potentials=(terms.Pendulum(9.0),))
BRAKED = replace(SWING, ports=(terms.Drag("linear", rate=0.3),))
CIRCLE = [(2.0 * np.sin(a), -2.0 * np.cos(a)) for a in np.linspace(0, 2 * np.pi, 25)]
CIRCLE[-1] = CIRCLE[0]


def on(law, *places):
    return terms.OnArc(*(places or (PIVOT, ACROSS, DOWN)), law)


def one(mass=1.0, bodies=1):
    return Parameters(torch.ones(1).double(), torch.full((1, bodies), mass).double())


def at(head, s, rate, params):
    """The state in the picture of coordinates and rates, each ``(n,)``."""
    inside = [torch.tensor(x, dtype=torch.float64).reshape(1, -1, 1) for x in (s, rate)]
    return head.outward(PhaseState(inside[0], params.mass[..., None] * inside[1]), params.mass)


def solved(slope, first, times):
    found = solve_ivp(slope, (0, times[-1]), first, t_eval=times, rtol=1e-11, atol=1e-12)
    return found.y


@pytest.mark.parametrize("mass", [1.0, 2.5])
def test_a_pendulum_that_swings_far_is_the_equation_s_and_not_a_trap_s(mass):
    head, params = build(on(BRAKED), 1, 0.01).double(), one(mass)
    start = at(head, [2.5], [0.0], params)
    path = rollout(head, start, params, 4000, 0.001, every=100)
    rate = 0.3 / mass
    s, v = solved(lambda _, x: [x[1], -9.0 * np.sin(x[0]) - rate * x[1]], [2.5, 0.0], path.times)
    place = np.array(PIVOT) + np.sin(s)[:, None] * ACROSS + np.cos(s)[:, None] * DOWN
    speed = (np.cos(s)[:, None] * ACROSS - np.sin(s)[:, None] * DOWN) * v[:, None]
    assert np.abs(path.states.q[0, :, 0].numpy() - place).max() < 2e-6
    assert np.abs(path.states.p[0, :, 0].numpy() / mass - speed).max() < 1e-5


def test_a_circle_without_friction_keeps_its_energy_however_it_goes_round():
    for rate in (1.0, 8.0):  # it swings, and it goes over the top
        head, params = build(on(SWING), 1, 0.01).double(), one(1.5)
        start = at(head, [0.4], [rate], params)
        path = rollout(head, start, params, 5000, 0.01)
        energy = head.energy(path.states, params).detach()
        assert float((energy / energy[:, :1] - 1).abs().max()) < 1e-3
        by_hand = 1.5 * (rate**2 / 2 - 9.0 * np.cos(0.4))
        assert float(energy[0, 0]) == pytest.approx(by_hand, rel=1e-6)
        seen = path.states.q[0, :, 0]
        frame = torch.tensor([ACROSS, DOWN]).double()
        inside = (seen - torch.tensor(PIVOT).double()) @ torch.linalg.inv(frame)
        assert float((inside.norm(dim=-1) - 1).abs().max()) < 1e-6


def test_stepping_in_the_picture_is_stepping_along_the_curve():
    head, params = build(on(BRAKED), 1, 0.01).double(), one()
    state = start = at(head, [-1.0], [2.0], params)
    for _ in range(50):
        state, _ = head.advance(state, params, 0.01)
    path = rollout(head, start, params, 50, 0.01)
    torch.testing.assert_close(state.flat, path.at(-1).flat, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    ("curve", "s"),
    [
        (Line((1.0, -2.0, 0.5), (1.0, 2.0, -2.0)), [-1.5, 0.0, 3.0]),
        (Arc(PIVOT, ACROSS, DOWN), [-3.0, 0.2, 1.7]),
        (Drawn(CIRCLE), [0.1, 6.0, 12.0]),
        (Drawn([(0.0, 0.0), (1.0, 1.0), (2.5, 1.0)]), [-0.4, 1.0, 3.5]),  # also beyond its ends
    ],
)
def test_coordinates_and_places_are_each_other_s_inverse(curve, s):
    s = torch.tensor(s, dtype=torch.float64)[:, None]
    assert torch.allclose(curve.coordinate(curve.place(s)), s, atol=1e-9)
    rate = torch.tensor([[0.3], [-2.0], [1.0]], dtype=torch.float64)
    velocity = curve.velocity(s, rate)
    assert torch.allclose(curve.rate(s, velocity), rate, atol=1e-9)
    nudged = (curve.place(s + 1e-6 * rate) - curve.place(s - 1e-6 * rate)) / 2e-6
    assert torch.allclose(velocity, nudged, atol=1e-7)
    power = (curve.pull(s, rate) * velocity).sum(-1, keepdim=True)
    assert torch.allclose(power, rate.square(), rtol=1e-6)


def test_a_drawn_circle_is_the_circle():
    drawn = Drawn(CIRCLE)
    assert drawn.length == pytest.approx(4 * np.pi, rel=1e-4)
    law = terms.Hamiltonian(potentials=(terms.Pendulum(9.0, length=2.0),))
    params = one()
    curve = build(terms.OnCurve(tuple(CIRCLE), law), 1, 0.01).double()
    arc = build(on(SWING, (0.0, 0.0), (2.0, 0.0), (0.0, -2.0)), 1, 0.01).double()
    start = at(arc, [1.2], [0.5], params)
    paths = [rollout(head, start, params, 200, 0.01).states.q for head in (curve, arc)]
    assert float((paths[0] - paths[1]).abs().max()) < 5e-3
    speed = curve.curve.tangent(torch.linspace(0, 12, 99).double()[:, None]).norm(dim=-1)
    assert float((speed - 1).abs().max()) < 1e-6


def test_what_is_beside_a_curve_is_taken_to_where_it_would_be():
    rail = build(terms.OnLine((0.0, 1.0), (2.0, 0.0), SWING), 1, 0.01).double()
    beside = PhaseState(
        torch.tensor([[[0.3, 5.0]]]).double(), torch.tensor([[[0.2, 9.0]]]).double()
    )
    inside = rail.inward(beside, one())
    assert inside.q.item() == pytest.approx(0.3) and inside.p.item() == pytest.approx(0.2)
    with pytest.raises(ValueError, match="must point somewhere"):
        Line((0.0, 0.0), (0.0, 0.0))
    with pytest.raises(ValueError, match="must span a plane"):
        Arc((0.0, 0.0), (1.0, 0.0), (2.0, 0.0))
    with pytest.raises(ValueError, match="three points or more"):
        Drawn([(0.0, 0.0), (1.0, 0.0)])


def double_pendulum(l1, l2, m1, m2, g):
    """Points on massless rods: the textbook's accelerations."""

    def slope(_, x):
        a, b, v, w = x
        d = a - b
        matrix = [[(m1 + m2) * l1, m2 * l2 * np.cos(d)], [l1 * np.cos(d), l2]]
        right = [
            -m2 * l2 * w**2 * np.sin(d) - (m1 + m2) * g * np.sin(a),
            l1 * v**2 * np.sin(d) - g * np.sin(b),
        ]
        return [v, w, *np.linalg.solve(matrix, right)]

    return slope


def test_a_double_pendulum_in_a_tilted_picture_is_the_textbook_s():
    law = terms.Links((0.5, 0.3), (1.0, 0.4), 9.8)
    head = build(terms.OnChain(PIVOT, ACROSS, DOWN, (0.5, 0.3), law), 2, 0.01).double()
    params = one(bodies=2)
    start = at(head, [1.2, -0.7], [0.5, 3.0], params)
    path = rollout(head, start, params, 500, 0.002, every=25)
    a, b, *_ = solved(double_pendulum(0.5, 0.3, 1.0, 0.4, 9.8), [1.2, -0.7, 0.5, 3.0], path.times)
    rods = [np.sin(x)[:, None] * ACROSS + np.cos(x)[:, None] * DOWN for x in (a, b)]
    first = np.array(PIVOT) + 0.5 * rods[0]
    seen = path.states.q[0].numpy()
    assert np.abs(seen[:, 0] - first).max() < 1e-5
    assert np.abs(seen[:, 1] - first - 0.3 * rods[1]).max() < 1e-5
    energy = head.energy(path.states, params).detach()
    assert head.conserves and float((energy / energy[:, :1] - 1).abs().max()) < 1e-6


def test_a_rod_s_inertia_slows_it_and_joints_with_friction_lose_energy():
    rod = terms.Links((0.8,), (1.0,), 9.8, inertia=(-(0.8**2) / 4 + 0.8**2 / 12 - 0.75 * 0.0,))
    head, params = build(rod, 1, 0.01, space=1).double(), one()
    start = PhaseState(torch.full((1, 1, 1), 0.01).double(), torch.zeros(1, 1, 1).double())
    acceleration = 9.8 * 0.8 / (0.8**2 * (1 - 1 / 4 + 1 / 12))
    later = rollout(head, start, params, 100, 0.001).states.q[0, -1].item()
    assert later == pytest.approx(0.01 * np.cos(0.1 * acceleration**0.5), rel=1e-4)
    braked = build(replace(rod, ports=(terms.Drag(rate=0.2),)), 1, 0.01, space=1).double()
    path = rollout(braked, start, params, 250, 0.01)
    energy = braked.energy(path.states, params).detach()[0]
    assert bool((energy.diff() < 1e-12).all()) and not braked.conserves


def test_each_has_its_own_law_and_springs_join_them():
    slow = terms.Hamiltonian(potentials=(terms.Trap(4.0, centre=(1.0,)),))
    fast = terms.Hamiltonian(potentials=(terms.Trap(9.0),))
    params = Parameters(torch.ones(1).double(), torch.tensor([[1.0, 2.0]]).double())
    state = PhaseState(*torch.tensor([[[[1.5], [-0.3]]], [[[0.0], [1.0]]]]).double())
    for springs in ((), (terms.Spring(0, 1, 3.0, rest=0.5),)):
        head = build(terms.Each((slow, fast), springs), 2, 0.01, space=1).double()
        path = rollout(head, state, params, 1500, 0.001, every=50)
        k = 3.0 if springs else 0.0

        def slope(_, x, k=k):
            pull = k * (x[0] - x[1] - 0.5)
            return [x[2], x[3], -4.0 * (x[0] - 1.0) - pull, (-9.0 * x[1] + pull) / 2]

        found = solved(slope, [1.5, -0.3, 0.0, 0.5], path.times)
        assert np.abs(path.states.q[0, :, :, 0].numpy().T - found[:2]).max() < 5e-6
        energy = head.energy(path.states, params).detach()
        assert head.conserves and float((energy / energy[:, :1] - 1).abs().max()) < 1e-5


@pytest.mark.parametrize(
    "apart",
    [pytest.param(0.0, marks=pytest.mark.slow), 0.8, pytest.param(-1e6, marks=pytest.mark.slow)],
)
def test_pendulums_with_pivots_of_their_own_share_nothing_but_their_spring(apart):
    arcs = on(SWING), on(BRAKED, (2.0, 1.0), (0.4, 0.0), (0.0, -0.4))
    head = build(terms.Each(arcs, (terms.Spring(0, 1, 1.5, apart=apart),)), 2, 0.01).double()
    params = one(bodies=2)
    parts = [at(law, [s], [0.0], one()) for law, s in zip(head.laws, (0.8, -0.2), strict=True)]
    start = PhaseState(*(torch.cat([getattr(x, k) for x in parts], -2) for k in "qp"))
    path = rollout(head, start, params, 1500, 0.001, every=50)

    def slope(_, x):
        pull, lost = np.array([1.0, -1.0]) * 1.5 * (x[0] - x[1]), np.array([0.0, 0.3 * x[3]])
        if apart:  # an exact spring between two points
            between = [apart + np.sin(x[1]) - np.sin(x[0]), np.cos(x[0]) - np.cos(x[1])]
            far = np.hypot(*between)
            drawn = 1.5 * (far - abs(apart)) / far * np.array(between)
            along = np.stack([np.cos(x[:2]), np.sin(x[:2])], -1)
            pull = along @ drawn * [-1, 1]
        return [x[2], x[3], *(-9 * np.sin(x[:2]) - pull - lost)]

    found = solved(slope, [0.8, -0.2, 0.0, 0.0], path.times)
    for n, law in enumerate(head.laws):
        seen = law.curve.coordinate(path.states.q[0, :, [n]])
        assert np.abs(seen[..., 0, 0].numpy() - found[n]).max() < 5e-6
    assert not head.conserves


FALL = terms.Hamiltonian(potentials=(terms.Along((0.3, -9.8)),))
UNITS = [
    (on(BRAKED), 1),
    (terms.OnLine(PIVOT, ACROSS, terms.Hamiltonian(potentials=(terms.Uniform((0.4,)),))), 1),
    (terms.OnCurve(tuple(CIRCLE), terms.Hamiltonian(potentials=(terms.Trap(2.0, (1.0,)),))), 1),
    (terms.OnChain(PIVOT, ACROSS, DOWN, (1.0, 0.5), terms.Links((1.0, 0.5), (1.0, 2.0), 9.8)), 2),
    (terms.Each((on(BRAKED), on(SWING)), (terms.Spring(0, 1, 1.5, 0.3, apart=0.8),)), 2),
    (
        terms.OnLine(
            PIVOT, ACROSS, terms.Hamiltonian(potentials=(terms.Well(4.0, 0.3, 0.5, -0.2),))
        ),
        1,
    ),
    (terms.OnLine(PIVOT, ACROSS, terms.Walled(SWING, 0.2, 0.8, (1.0,))), 1),
    (terms.OnCurve(tuple(CIRCLE), FALL), 1),
    (terms.OnCurve(tuple(CIRCLE), terms.Rubbed(FALL, 0.02)), 1),
]


def on_its_curve(head, bodies):
    torch.manual_seed(1)
    s, rate = torch.rand(2, 4, bodies, 1, dtype=torch.float64) / 3
    mass = torch.linspace(0.6, 1.4, 4).double()[:, None].expand(4, bodies)
    parts = getattr(head, "laws", [head])
    each = [slice(n, n + 1) for n in range(bodies)] if len(parts) > 1 else [slice(None)]
    found = [
        law.outward(PhaseState(s[:, i], mass[:, i, None] * rate[:, i]), mass[:, i])
        for law, i in zip(parts, each, strict=True)
    ]
    state = PhaseState(*(torch.cat([getattr(x, k) for x in found], -2) for k in "qp"))
    return state, Parameters(torch.ones(4).double(), mass)


@pytest.mark.parametrize(("term", "bodies"), UNITS)
def test_bound_models_keep_every_contract_of_a_head(term, bodies):
    head = build(term, bodies, 0.01)
    start, params = on_its_curve(head.double(), bodies)
    check_head(build(term, bodies, 0.01), bodies, 2, params, start)


@pytest.mark.parametrize(("term", "bodies"), UNITS)
def test_in_other_units_it_is_the_same_motion(term, bodies):
    length, seconds = 3.0, 0.7
    head = build(term, bodies, 0.01).double()
    other = build(term.counted_in(length, seconds), bodies, 0.01).double()
    start, params = on_its_curve(head, bodies)
    path = rollout(head, start, params, 40, 0.007)
    counted = PhaseState(start.q / length, start.p * seconds / length)
    again = rollout(other, counted, params, 40, 0.01)
    assert float((again.states.q * length - path.states.q).abs().max()) < 1e-6


def test_numbers_are_learned_through_what_is_seen():
    head = build(on(terms.Hamiltonian(potentials=(terms.Pendulum(6.0),))), 1, 0.01).double()
    truth, params = build(on(SWING), 1, 0.01).double(), one()
    start = at(truth, [1.0], [0.0], params)
    target = truth.trajectory(start, params, 100, 0.01, 10).states.q.detach()
    optimiser = torch.optim.Adam(head.parameters(), 0.2)
    for _ in range(60):
        optimiser.zero_grad()
        found = head.trajectory(start, params, 100, 0.01, 10).states.q
        (found - target).square().sum().backward()
        optimiser.step()
    assert head.law.potential.rate2.item() == pytest.approx(9.0, rel=0.02)
    fixed = build(on(terms.Hamiltonian(potentials=(terms.Pendulum(9.0, learned=False),))), 1, 0.01)
    assert not list(fixed.parameters())


@pytest.mark.parametrize(
    ("term", "bodies", "words"),
    [
        (terms.Each((SWING,)), 2, "laws must have 2 entries"),
        (terms.Each((SWING, SWING), (terms.Spring(0, 1, 1.0),)), 2, "body 0 is free in 2"),
        (terms.Each((on(SWING), on(SWING)), (terms.Spring(0, 2, 1.0),)), 2, "got 0 and 2"),
        (terms.OnChain(PIVOT, ACROSS, DOWN, (1.0,), SWING), 2, "lengths must have 2"),
        (terms.Links((1.0,), (1.0,), 9.8), 2, "must have 2 numbers"),
        (terms.Hamiltonian(potentials=(terms.Trap(1.0, (0.0,)),)), 1, "centre must have 2"),
    ],
)
def test_terms_that_do_not_fit_are_refused(term, bodies, words):
    with pytest.raises(ValueError, match=words):
        build(term, bodies, 0.01)
