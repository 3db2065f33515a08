"""Terms: what they build, how they are written down and read again, also by older versions."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from torch import Tensor, nn

from dynamics import HEADS, Hamiltonian, Parameters, PhaseState, build, rollout, terms
from dynamics.terms import TERMS, Term, from_config, to_config

FLAT = json.loads((Path(__file__).parent / "data" / "flat_terms.json").read_text())
OURS = TERMS.ours()
NEEDED = {
    terms.Trap: {"stiffness": 2.0},
    terms.Shortcut: {"beside": (terms.Radial(), terms.Uniform())},
    terms.Walled: {
        "free": terms.Hamiltonian(potentials=(terms.Uniform(),)),
        "place": 0.5,
        "restitution": 0.9,
        "normal": (0.0, -1.0),
    },
}
FREE = terms.Hamiltonian(potentials=(terms.NoPotential(),))
ON_CIRCLE = {"pivot": (0.0, 1.0), "across": (2.0, 0.0), "down": (0.0, -2.0)}
NEEDED |= {
    terms.Pendulum: {"rate2": 4.0},
    terms.Well: {"stiffness": 4.0},
    terms.EllipticTrap: {"stiffness": ((4.0, 1.0), (1.0, 9.0)), "centre": (0.5, 0.0)},
    terms.Spring: {"first": 0, "second": 1, "stiffness": 2.0},
    terms.Contact: {"first": 0, "second": 1, "reach": 0.5, "restitution": 0.8},
    terms.Each: {"laws": (FREE, FREE), "springs": (terms.Spring(0, 1, 2.0),)},
    terms.OnLine: {"point": (0.0, 1.0), "direction": (1.0, 0.0), "law": FREE},
    terms.OnArc: {**ON_CIRCLE, "law": FREE},
    terms.OnCurve: {"points": ((0.0, 0.0), (1.0, 0.5), (2.0, 0.0)), "law": FREE},
    terms.OnChain: {**ON_CIRCLE, "lengths": (1.0, 0.5), "law": FREE},
    terms.Along: {"acceleration": (0.0, -9.8)},
    terms.Rubbed: {
        "free": terms.Hamiltonian(potentials=(terms.Along((0.0, -9.8)),)),
        "coefficient": 0.1,
    },
    terms.Strung: {"free": FREE, "centre": (0.0, 1.0), "length": 0.5},
    terms.Tether: {"stiffness": 4.0, "rest": 0.5, "centre": (0.0, 1.0)},
    terms.Centre: {"strength": -4.0, "power": 2.0, "centre": (0.0, 1.0)},
    terms.Turning: {"rate": (2.0,)},
    terms.PlacewiseFriction: {"rates": (-1.0, 0.2, 1.0)},
    terms.Sinusoid: {"along": (1.0, 0.5), "across": (0.0, 2.0), "rate": 3.0},
    terms.Lift: {"rate": 2.0, "fades": 0.5},
    terms.Clocked: {"free": FREE, "timed": (terms.Lift(2.0, 0.5),)},
    terms.Links: {"lengths": (1.0, 0.5), "masses": (1.0, 2.0), "gravity": 9.8},
}
each_head = pytest.mark.parametrize("name", HEADS.ours())


def example(kind: type[Term], **changes) -> Term:
    return kind(**{**NEEDED.get(kind, {}), **changes})


def through_json(each: Term) -> Term:
    return from_config(json.loads(json.dumps(to_config(each))))


@pytest.mark.parametrize("name", OURS)
@settings(max_examples=5)
@given(data=st.data())
def test_any_term_of_any_numbers_survives_json(name, data):
    kind = TERMS[name]
    drawn = {
        "int": st.integers(1, 99),
        "float": st.floats(0.1, 9),
        "bool": st.booleans(),
        "float | None": st.none() | st.floats(0.1, 9),
    }
    changes = {
        field.name: data.draw(drawn[field.type])
        for field in fields(kind)
        if field.type in drawn and field.name != "restitution"
    }
    each = example(kind, **changes)
    assert to_config(each)["term"] == name
    assert through_json(each) == each
    assert json.loads(json.dumps(to_config(each))) == to_config(each)


@each_head
def test_heads_survive_json(name):
    assert through_json(HEADS[name]) == HEADS[name]


@pytest.mark.parametrize("name", FLAT)
def test_what_older_versions_wrote_builds_a_model_with_the_weights_they_kept(name):
    flat, weights = FLAT[name]["terms"], FLAT[name]["weights"]
    each = from_config(flat)
    assert through_json(each) == each
    dt, space = (0.002, 1) if flat["kind"] == "generalised" else (0.01, 2)
    found = build(each, 2, dt, space).state_dict()
    assert {key: list(value.shape) for key, value in found.items()} == weights


@each_head
def test_the_study_s_heads_are_those_of_older_versions(name):
    assert from_config(FLAT[name]["terms"]) == HEADS[name]


def test_an_older_table_may_lack_what_came_later():
    assert from_config({"kind": "hamiltonian"}) == terms.Hamiltonian()
    assert from_config({"kind": "residual", "width": 8}) == terms.Residual(8)
    mass_matrix = from_config({"kind": "generalised", "formalism": "lagrangian"})
    assert mass_matrix == terms.Lagrangian()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "names its 'term'"),
        ({"term": "grape"}, "unknown term 'grape'; did you mean 'graph'"),
        ({"term": "pathlib:Path"}, "'pathlib:Path' is no term"),
        ({"term": "residual", "activation": "tanh"}, "unknown field of 'residual' 'activation'"),
        ({"term": "radial", "witdh": 3}, "'witdh'; did you mean 'width'"),
        ({"term": "trap"}, "'trap': .* 'stiffness'"),
        ({"term": "hamiltonian", "potentials": [{"term": "drag"}]}, "is no PotentialTerm"),
        ({"term": "hamiltonian", "potentials": []}, "potentials is empty"),
        ({"term": "hamiltonian", "ports": ["bath"]}, "'bath' is no PortTerm"),
        ({"kind": "hamiltonian", "kinetic": "none"}, "unknown term 'none'"),
        ({"kind": "hamiltonian", "ports": ["baht"]}, "unknown term 'baht'; did you mean 'bath'"),
        ({"kind": "hamiltonian", "ports": ["trap"]}, "'trap': .* 'stiffness'"),
        ({"kind": "hamiltonian", "witdh": 3}, "'witdh'; did you mean 'width'"),
        ({"kind": "apple"}, "unknown term 'apple'"),
    ],
)
@pytest.mark.usefixtures("unchecked")
def test_configurations_with_unknown_words_are_refused_in_one_line(data, message):
    with pytest.raises(ValueError, match=message) as told:
        from_config(data)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"integrator": "leapfog"}, "unknown integrator 'leapfog'; did you mean 'leapfrog'"),
        ({"potentials": (terms.Radial(activation="relu"),)}, "unknown activation 'relu'"),
        ({"potentials": (terms.Radial(source="spin"),)}, "unknown source 'spin'"),
        ({"potentials": (terms.Mapped("odd"),)}, "unknown 'odd'"),
        ({"ports": (terms.Drag("cubic"),)}, "unknown law 'cubic'"),
    ],
)
def test_models_with_unknown_words_are_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        build(terms.Hamiltonian(**changes), 3, 0.01)


@pytest.mark.usefixtures("unchecked")
def test_a_part_in_the_wrong_place_is_named():
    with pytest.raises(TypeError, match="potentials is a tuple of terms, got Radial"):
        terms.Hamiltonian(potentials=terms.Radial())
    with pytest.raises(TypeError, match="kinetic: Uniform.* is no KineticTerm"):
        terms.Hamiltonian(terms.Uniform())
    with pytest.raises(TypeError, match="ports: LinearFriction.* is no Drag"):
        terms.Lagrangian(ports=(terms.LinearFriction(),))


def test_a_change_reaches_every_part_that_has_the_field():
    wide = HEADS["symplectic"].throughout(width=8, integrator="yoshida4")
    assert (wide.kinetic.width, wide.potentials[0].width) == (8, 8)
    assert wide.integrator == "yoshida4"
    inner = example(terms.Walled).throughout(integrator="rk4")
    assert inner.free.integrator == "rk4"
    with pytest.raises(ValueError, match="unknown field of Hamiltonian 'wdth'; did you .* 'width'"):
        HEADS["factored"].throughout(wdth=8)


def test_numbers_with_units_are_converted_wherever_they_stand():
    box = terms.Hamiltonian(
        potentials=(terms.Knots(reach=3.0), terms.Shortcut((terms.Trap(2.0),))), box=6.0
    )
    found = terms.Walled(box, 1.5, 0.9, (1.0, 0.0)).counted_in(length=3.0, seconds=2.0)
    knots, shortcut = found.free.potentials
    assert (found.place, found.free.box, knots.reach) == (0.5, 2.0, 1.0)
    assert shortcut.beside == (terms.Trap(8.0),)
    assert terms.HardDisks(4.0).counted_in(2.0, 1.0).box == 2.0


FALL = terms.Uniform((0.3, -9.8))
PLACED = [
    terms.Hamiltonian(potentials=(terms.Tether(20.0, 0.5, (0.1, 0.2)), FALL)),
    terms.Hamiltonian(potentials=(terms.Centre(-4.0, 1.7, (0.1, 0.2), near=0.8),)),
    terms.Hamiltonian(potentials=(FALL,), ports=(terms.Turning((2.0,)),)),
    terms.Strung(terms.Hamiltonian(potentials=(FALL,)), (0.1, 0.2), 0.7),
    terms.Clocked(terms.Hamiltonian(potentials=(FALL,)), (terms.Lift(2.0, 0.5),)),
    terms.Clocked(
        terms.Hamiltonian(potentials=(FALL,)), (terms.Sinusoid((9.0, 1.0), (0.0, 5.0), 7.0),)
    ),
]


@pytest.mark.parametrize("term", PLACED)
def test_in_other_units_a_body_moves_alike(term):
    length, seconds, steps = 3.0, 0.7, 60
    start = PhaseState(*torch.tensor([[[[0.5, 0.3]]], [[[0.4, 0.9]]]]).double())
    law = Parameters(torch.ones(1).double(), torch.ones(1, 1).double()).with_scalar("clock", 0.0)
    head = build(term, 1, 0.01).double().requires_grad_(False)
    path = head.trajectory(start, law, steps, 0.014)
    counted = PhaseState(start.q / length, start.p * seconds / length)
    other = build(term.counted_in(length, seconds), 1, 0.01).double()
    again = other.trajectory(counted, law, steps, 0.014 / seconds)
    torch.testing.assert_close(again.states.q * length, path.states.q, rtol=0, atol=1e-5)
    assert float((path.states.q - start.q[:, None]).abs().max()) > 0.3


@pytest.mark.parametrize(("length", "seconds"), [(1.0, 1.0), (3.0, 0.7)])
def test_van_der_pols_oscillator_is_that_of_another_integrator_in_any_unit(length, seconds):
    air = terms.PlacewiseFriction((-1.2, 0.3, 1.2), learned=False)
    term = terms.Hamiltonian(potentials=(terms.Trap(4.0),), ports=(air,))
    head = build(term.counted_in(length, seconds), 1, 0.01, 1).double()
    start = PhaseState(torch.full((1, 1, 1), 0.4 / length).double(), torch.zeros(1, 1, 1).double())
    law = Parameters(torch.ones(1).double(), torch.full((1, 1), 2.0).double())
    path = head.trajectory(start, law, 4000, 0.005 / seconds).states.q[0, :, 0, 0] * length
    times = 0.005 * np.arange(4001)
    found = solve_ivp(
        lambda _, y: [y[1], -2 * y[0] - (0.6 * y[0] ** 2 + 0.15 * y[0] - 0.6) * y[1]],
        (0.0, times[-1]), (0.4, 0.0), t_eval=times, rtol=1e-10, atol=1e-12,
    )  # fmt: skip
    assert np.abs(path.detach().numpy() - found.y[0]).max() < 3e-4 < 1.5 < found.y[0].max()
    with pytest.raises(ValueError, match="acts on a line"):
        build(term, 1, 0.01, 2)


def test_a_magnetic_field_turns_velocities_exactly_and_does_no_work():
    momentum = torch.tensor([[[0.3, -1.0, 0.5]]], dtype=torch.float64)
    start = PhaseState(torch.zeros_like(momentum), momentum)
    law = Parameters(torch.ones(1).double(), torch.full((1, 1), 2.0).double())
    free = terms.Hamiltonian(
        potentials=(terms.NoPotential(),), ports=(terms.Turning((0.0, 0.0, 2.0), learned=False),)
    )
    head = build(free, 1, 0.01, space=3).double()
    later = head.trajectory(start, law, 7, 0.2).states.p[0, -1, 0]
    c, s = math.cos(2.0 * 1.4), math.sin(2.0 * 1.4)
    turned = [0.3 * c + 1.0 * s, 0.3 * s - 1.0 * c, 0.5]
    expected = torch.tensor(turned, dtype=torch.float64)
    torch.testing.assert_close(later, expected, rtol=0, atol=1e-13)
    assert head.conserves
    with pytest.raises(ValueError, match="one number in the plane and three in space"):
        build(free, 1, 0.01, space=2)


def test_a_shortcut_among_other_potentials_is_not_taken_for_a_conserved_energy():
    among = terms.Hamiltonian(potentials=(terms.Uniform(), terms.Shortcut((terms.Radial(),))))
    beside = terms.Hamiltonian(potentials=(terms.Uniform(), terms.Radial()))
    assert build(beside, 2, 0.01).conserves
    assert not build(among, 2, 0.01).conserves


class Spring(nn.Module):
    """V = k(G) |q|^2 / 2, the strength a learned multiple of a power of G."""

    def __init__(self, power: int) -> None:
        super().__init__()
        self.power, self.raw = power, nn.Parameter(torch.zeros(()))

    def strength(self, params: Parameters) -> Tensor:
        return self.raw.exp() * params.coupling**self.power

    def energy(self, q: Tensor, params: Parameters) -> Tensor:
        return 0.5 * self.strength(params) * q.square().sum((-2, -1))

    def force(self, q: Tensor, params: Parameters) -> Tensor:
        return -self.strength(params)[..., None, None] * q


@dataclass(frozen=True)
class Springs(terms.PotentialTerm):
    """A term that is none of ours: nothing registers it, its import path is its name."""

    power: int = 1
    beside: tuple[terms.PotentialTerm, ...] = ()

    def build(self, sizes: terms.Sizes) -> Spring:
        return Spring(self.power)


def test_a_stranger_s_term_is_written_down_built_trained_and_rolled():
    model = terms.Hamiltonian(potentials=(Springs(3, (terms.Uniform(),)), terms.Trap(1.0)))
    data = to_config(model)["potentials"][0]
    assert data["term"] == "tests.dynamics.test_terms:Springs"
    assert data["beside"] == [to_config(terms.Uniform())]
    assert through_json(model) == model
    head = build(model, 3, 0.01).double()
    assert isinstance(head, Hamiltonian)
    state = PhaseState(*torch.randn(2, 4, 3, 2, dtype=torch.float64))
    params = Parameters(torch.linspace(0.5, 1.5, 4).double(), torch.ones(4, 3).double())
    target = -2.0 * params.coupling[..., None, None] ** 3 * state.q - state.q
    optimiser = torch.optim.Adam(head.parameters(), 0.1)
    for _ in range(100):
        optimiser.zero_grad()
        (head.force(state, params) - target).square().mean().backward()
        optimiser.step()
    spring = head.potential.parts[0]
    assert float(spring.raw.detach().exp()) == pytest.approx(2.0, rel=0.01)
    run = rollout(head, state, params, 20, 0.01)
    assert bool(run.states.q.isfinite().all())
    again = build(through_json(model), 3, 0.01).double()
    again.load_state_dict(head.state_dict())
    assert torch.equal(rollout(again, state, params, 20, 0.01).states.q, run.states.q)


def test_a_registered_name_is_the_name_in_configurations(monkeypatch):
    monkeypatch.setitem(TERMS._parts, "springs", Springs)
    monkeypatch.setitem(TERMS._modules, "springs", __name__)
    assert to_config(Springs())["term"] == "springs"
    assert through_json(Springs(2)) == Springs(2)
