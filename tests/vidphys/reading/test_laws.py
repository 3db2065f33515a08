"""Any term of a law can be taken away, or turned round, where the model is rolled."""

import pytest
import torch

from dynamics import Parameters, PhaseState, build, terms
from vidphys.errors import InputError
from vidphys.reading.laws import Law, factors_of

MODEL = terms.Hamiltonian(
    potentials=(
        terms.Radial(width=8),
        terms.Uniform(acceleration=(0.0, -2.0)),
        terms.Trap(3.0, learned=True),
    ),
    ports=(terms.Drag(strength="factored"),),
)


@pytest.fixture
def law():
    torch.manual_seed(0)
    params = Parameters(torch.tensor(1.5), torch.tensor([1.0, 2.0]), scalars={})
    return Law(build(MODEL, bodies=2, dt=0.01, conditions=4), params.with_scalar("friction", 0.4))


def force(law):
    q = torch.tensor([[1.0, 0.5], [-0.5, 0.2]])
    return law.head.force(PhaseState(q, 0 * q), law.params).detach()


def kept(law):
    """Speed that one second of friction leaves, of a body that nothing else moves."""
    start = PhaseState(torch.zeros(1, 2, 2), torch.ones(1, 2, 2))
    free = law.changed({"pair": 0, "gravity": 0, "stiffness": 0})
    params = free.params.map(lambda x: x[None])
    with torch.no_grad():
        return float(free.head.trajectory(start, params, 100, 0.01).states.p[0, -1, 0, 0])


def test_a_model_names_all_that_can_be_taken_away(law):
    assert set(law.quantities) >= {"pair", "gravity", "stiffness", "friction", "mass", "mass2"}


@pytest.mark.parametrize("name", ["pair", "gravity", "stiffness"])
def test_one_term_goes_and_the_others_stay(law, name):
    others = {"pair", "gravity", "stiffness"} - {name}
    gone, alone = law.changed({name: 0.0}), law.changed(dict.fromkeys(others, 0.0))
    assert not torch.allclose(force(gone), force(law))
    torch.testing.assert_close(force(gone) + force(alone), force(law))


def test_a_term_turned_round_pushes_the_other_way(law):
    alone = law.changed({"gravity": 0.0, "stiffness": 0.0})
    torch.testing.assert_close(force(alone.changed({"pair": -1.0})), -force(alone))


def test_friction_that_is_told_goes_too(law):
    assert kept(law) < 0.95
    assert kept(law.changed({"friction": 0.0})) == pytest.approx(1.0)
    assert law.params.scalar("friction") == pytest.approx(0.4)  # of the first, as it was


def test_only_what_has_a_sign_takes_a_negative_factor():
    assert factors_of(("pair=-1", "drive=-0.5")) == {"pair": -1.0, "drive": -0.5}
    with pytest.raises(InputError, match="friction must be zero or above"):
        factors_of(("friction=-1",))


FALL = terms.Hamiltonian(potentials=(terms.Uniform((0.0, -9.8)),))
BEAD = terms.Hamiltonian(potentials=(terms.Along((0.0, -9.8)),))
BOWL = ((-1.0, 1.0), (-0.5, 0.25), (0.0, 0.0), (0.5, 0.25), (1.0, 1.0))
# a model, a quantity, and the number that it is
NUMBERS = [
    (terms.OnCurve(BOWL, terms.Rubbed(BEAD, 0.2)), "friction", "law.coefficient"),
    (terms.OnCurve(BOWL, BEAD), "gravity", "law.potential.acceleration"),
    (terms.Strung(FALL, (0.0, 1.0), 0.5), "length", "length"),
    (terms.Strung(FALL, (0.0, 1.0), 0.5), "gravity", "free.potential.acceleration"),
    (
        terms.Hamiltonian(potentials=(terms.Tether(20.0, 0.5, (0.0, 1.0)),)),
        "stiffness",
        "potential.stiffness",
    ),
    (
        terms.Hamiltonian(potentials=(terms.Tether(20.0, 0.5, (0.0, 1.0)),)),
        "length",
        "potential.rest",
    ),
    (
        terms.Hamiltonian(potentials=(terms.Centre(-4.0, 2.0, (0.0, 1.0)),)),
        "centre",
        "potential.strength",
    ),
    (
        terms.Hamiltonian(potentials=(terms.NoPotential(),), ports=(terms.Turning((2.0,)),)),
        "turning",
        "ports.0.rate",
    ),
    (terms.Clocked(FALL, (terms.Lift(2.0, 0.5),)), "lift", "timed.0.rate"),
]


@pytest.mark.parametrize(("term", "name", "number"), NUMBERS)
def test_a_factor_multiplies_just_the_number_that_it_names(term, name, number):
    law = Law(build(term, bodies=1, dt=0.01), Parameters(torch.ones(1), torch.ones(1, 1)))
    assert name in law.quantities
    before, after = (dict(x.head.named_parameters()) for x in (law, law.changed({name: 3.0})))
    for each, value in before.items():
        factor = 3.0 if each == number else 1.0
        torch.testing.assert_close(after[each], factor * value)
