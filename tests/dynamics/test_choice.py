"""Which form of a trained model is rolled: the same answer by each, and nothing hidden."""

import copy
import warnings

import pytest
import torch

from dynamics import (
    HEADS,
    DomainWarning,
    EnergyWarning,
    Hamiltonian,
    Parameters,
    build,
    rollout,
    terms,
)
from dynamics.compiled import CompiledHead, form_of
from dynamics.compiled import build as building
from dynamics.compiled.choice import FEW, PAYS, TOLERANCE
from tests.dynamics.test_compiled import DT, KINDS, episodes, model

LONG = -(-PAYS // FEW)  # steps of as few episodes as may be
TRAPPED = terms.Hamiltonian(potentials=(terms.Displacement(), terms.Trap(1.0)))
LAWS = {
    "as it was": lambda law: law,
    "flipped": lambda law: law.with_coupling(-law.coupling),
    "other masses": lambda law: Parameters(law.coupling, 2 * law.mass),
}


def asked(head, count=8):
    """Episodes in the precision of a model."""
    return episodes(count, dtype=next(head.parameters()).dtype)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "dtype", [torch.float32, pytest.param(torch.float64, marks=pytest.mark.slow)]
)
def test_a_long_rollout_is_the_networks_to_the_tolerance_of_the_force(kind, dtype):
    head = model(kind).to(dtype)
    start, law = asked(head)
    form = form_of(head, start, law, LONG, DT)
    assert isinstance(form.head, CompiledHead) and not form.why
    for name, change in LAWS.items():
        found, exact = (rollout(x, start, change(law), 400, DT, 50) for x in (form.head, head))
        assert (found.report, exact.report) == (form.head.report, None)
        assert found.report.error <= found.report.tolerance == TOLERANCE
        # Twice integrated: an error of the force moves a body by |F| t^2 / 2m of it, times what
        # encounters make of that. A force that is wrong by a percent fails at once.
        away = (found.states.q - exact.states.q).abs().max()
        moved = (exact.states.q - exact.states.q[:, :1]).abs().max()
        assert away < 10 * TOLERANCE * moved, name
        drift = [_drift(head, each) for each in (found, exact)]
        assert drift[0] < 1.1 * drift[1] + 10 * TOLERANCE, name


def _drift(head, rolled):
    law = Parameters(rolled.params.coupling[:, None], rolled.params.mass[:, None])
    energy = head.energy(rolled.states, law).detach()
    return float(((energy - energy[:, :1]) / energy[:, :1]).abs().max())


@pytest.mark.parametrize(
    ("term", "why"),
    [
        (HEADS["factored-learned-kinetic"], "no ports and no learned kinetic energy"),
        (HEADS["unstructured"], "ResidualMap is no function of one displacement"),
        (TRAPPED, "numba rolls one learned pair law"),
    ],
)
def test_what_has_no_such_spline_is_rolled_as_it_is_and_why_is_said(term, why):
    head = build(term, 3, DT)
    form = form_of(head, *asked(head), None, DT)
    assert form.head is head and why in form.why


def test_a_model_with_friction_or_of_another_step_is_rolled_as_it_is(monkeypatch):
    unbuilt = lambda *_: pytest.fail("a spline was built for nothing")  # noqa: E731
    monkeypatch.setattr("dynamics.compiled.head.pair_spline", unbuilt)
    for more in ({"ports": (terms.LinearFriction(),)}, {"integrator": "kahan_li8"}):
        head = model("radial", **more)
        form = form_of(head, *asked(head), None, DT)
        assert form.head is head and form.why.startswith("numba ")


def test_a_short_rollout_is_the_networks_however_fast_the_machine_is():
    head = model("radial")
    start, law = asked(head)
    assert form_of(head, start, law, LONG - 1, DT).head is head
    assert form_of(head, start, law, LONG, DT).head is not head
    many, laws = asked(head, 2 * FEW)
    assert form_of(head, many, laws, LONG // 2 - 1, DT).head is head
    assert form_of(head, many, laws, LONG // 2, DT).head is not head


def test_steps_that_may_be_taken_apart_are_the_networks():
    head = model("radial", scale=200.0)
    start, law = asked(head)
    assert "in pieces" in form_of(head, start, law, None, 0.5).why
    assert isinstance(form_of(head, start, law, None, 0.5, substeps=False).head, CompiledHead)


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_spline_is_refused_and_the_network_rolls(kind, monkeypatch):
    spline = {"radial": building.RadialSpline, "displacement": building.PlaneSpline}[kind]
    right = spline.spline_gradient
    monkeypatch.setattr(spline, "spline_gradient", lambda *a: (1 + 2 * TOLERANCE) * right(*a))
    head = model(kind)
    start, law = asked(head)
    form = form_of(head, start, law, None, DT)
    assert form.head is head and "has a force error of 2.0e-04" in form.why
    monkeypatch.setattr(spline, "spline_gradient", lambda *a: (1 + TOLERANCE / 2) * right(*a))
    found = form_of(head, start, law, None, DT).head.report
    assert found.error == pytest.approx(TOLERANCE / 2, rel=0.1)


def test_the_model_itself_is_left_as_it_was_and_the_choice_is_the_same_again():
    head = model("displacement").float()
    before = copy.deepcopy(head.state_dict())
    start, law = asked(head)
    paths = [
        rollout(form_of(head, start, law, LONG, DT).head, start, law, 100, DT) for _ in range(2)
    ]
    assert torch.equal(paths[0].states.flat, paths[1].states.flat)
    assert paths[0].report == paths[1].report
    assert all(torch.equal(value, before[name]) for name, value in head.state_dict().items())
    assert all(weight.requires_grad for weight in head.parameters())


def test_what_a_rollout_warns_of_is_said_of_the_spline_too():
    head: Hamiltonian = model("radial", scale=20.0)
    start, law = asked(head)
    near = start.map(lambda x: 0.1 * x)
    head.see(near)
    for begun, dt, kind in ((start, DT, DomainWarning), (near, 0.2, EnergyWarning)):
        form = form_of(head, begun, law, None, dt, substeps=False)
        assert isinstance(form.head, CompiledHead)
        said = []
        for each in (form.head, head):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = rollout(each, begun, law, 100, dt, substeps=False)
            said.append([(x.kind, x.step) for x in found.findings])
        assert said[0] == said[1] and kind in [each for each, _ in said[0]]
