"""A push that takes a body to a place: exact where the law is known, and told in seen units."""

import math

import numpy as np
import pytest
import torch

from dynamics import Parameters, PhaseState, ballistic, build, terms
from vidphys.errors import InputError
from vidphys.reading.steering import SEARCHES, Aim, Way, steer

DT, STEPS = 0.01, 100
UNIT, SECOND = 300.0, 0.5  # pixels of the model's length, seconds of its time
PLACES, MOMENTA = [[0.0, 0.0], [1.0, 1.0]], [[1.0, 0.0], [0.0, 3.0]]
BALLS = PhaseState(torch.tensor([PLACES]), torch.tensor([MOMENTA]))
LAW = Parameters(torch.ones(1), torch.tensor([[1.0, 3.0]]))


def seen(head):
    return Way(head, LAW, DT, lambda q: UNIT * q + 50, SECOND)


@pytest.mark.parametrize("search", SEARCHES)
def test_free_bodies_are_pushed_by_what_they_lack(search):
    push = steer(seen(ballistic()), BALLS, STEPS, Aim((650.0, 350.0), 1, search=search))
    # it would be at (350, 650) pixels after half a second
    assert push.idle == pytest.approx(math.hypot(300, 300), rel=1e-5)
    tolerance = {"slopes": 0.05, "cross-entropy": 5.0}[search]
    assert push.left < tolerance and not push.bound
    assert push.change == pytest.approx(np.array([600.0, -600.0]), abs=2 * tolerance + 1)
    assert torch.equal(push.state.p[:, 0], BALLS.p[:, 0].double())
    exact = torch.tensor([3.0, -3.0]).double()  # momentum: three masses, a model's length a time
    assert torch.allclose(push.state.p[0, 1] - BALLS.p[0, 1], exact, atol=tolerance / 50)


@pytest.mark.parametrize("search", SEARCHES)
def test_no_push_is_stronger_than_it_may_be(search):
    push = steer(seen(ballistic()), BALLS, STEPS, Aim((650.0, 350.0), 1, 100.0, search))
    assert np.linalg.norm(push.change) <= 100.0 * (1 + 1e-3)
    assert push.left == pytest.approx(push.idle - 50, rel=0.01) and push.bound


def test_slopes_at_rest_lead_astray_where_many_tried_pushes_do_not():
    """A pendulum at rest, to be once around after a second: a small push swings back by then."""
    swing = terms.Hamiltonian(potentials=(terms.Pendulum(30.0),))
    head = build(swing, 1, DT, 1).double()
    law = Parameters(torch.ones(1).double(), torch.ones(1, 1).double())
    way = Way(head, law, DT, lambda q: q)
    start = PhaseState(torch.zeros(1, 1, 1).double(), torch.zeros(1, 1, 1).double())
    found = {
        name: steer(way, start, STEPS, Aim((2 * math.pi,), most=30.0, search=name)).left
        for name in SEARCHES
    }
    assert found["cross-entropy"] < 0.1
    assert found["cross-entropy"] < found["slopes"]


@pytest.mark.parametrize(
    ("aim", "said"),
    [
        (Aim((1.0, 1.0), 2), "`body` 3: there are 2"),
        (Aim((1.0,)), "`reach`: 1 numbers given, a place here has 2"),
        (Aim((1.0, 1.0), most=0.0), "`most` 0: must be above 0"),
    ],
)
def test_wrong_aims_are_refused(aim, said):
    with pytest.raises(InputError, match=said):
        steer(seen(ballistic()), BALLS, STEPS, aim)
