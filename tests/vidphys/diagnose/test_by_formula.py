"""A formula is sought where nothing else explains a recording, and told as a physicist reads it."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from dynamics import terms
from dynamics.terms import Pendulum, Well
from tests.vidphys.diagnose.test_explanations import Foretelling, Oracle
from vidphys.diagnose.explanations import choice
from vidphys.diagnose.explanations.formula import ByFormula, _ports, _potentials
from vidphys.diagnose.explanations.verdict import EXPLAINED, NOT, Verdict
from vidphys.diagnose.formula.formula import ALIKE, Formula
from vidphys.diagnose.formula.formula import Verdict as Judged
from vidphys.diagnose.formula.grammar import words
from vidphys.diagnose.formula.refusal import would_tell
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.diagnose.recordings.units import Units
from vidphys.experiments.formulas.laws import developed

X = np.linspace(-1.2, 1.5, 60)
END = 280


@pytest.fixture(scope="module")
def motion():
    places, times = next(case for case in developed() if case.name == "soft step").recording(3)
    return motion_of(places[:, :, None, None], float(times[0, 1] - times[0, 0]))


@pytest.fixture(scope="module")
def found(motion):
    return ByFormula.sought(motion, END, Units("m"))


@dataclass(frozen=True)
class Blind(Oracle):
    """One that explains so much of a recording."""

    status: str = NOT
    bent: bool = False

    def judged(self, tail):
        return Verdict(self.status, 0.5, 1.0, 0.0, 1.0, bent=self.bent)


def test_a_formula_foretells_what_was_held_out_and_is_told_with_units_and_intervals(found):
    assert found.verdict.status == EXPLAINED and found.forecast().beats_all
    law, tanh, friction, none = found.lines()
    assert law.startswith("Its law, found as a formula for -1.4") and "x'' = -3.99" in law
    assert tanh.startswith("  tanh(k x): times -3.99") and "m/s², k 2.0" in tanh
    assert " 1/m (95 %)" in tanh
    assert friction.startswith("  x': times -0.0") and friction.endswith(" 1/s (95 %)")
    assert none == "No specification is written: no term of a model carries this formula."
    assert found.specification() is None and "no friction" in found.changed()


def test_it_is_sought_only_where_nothing_explains_the_recording(monkeypatch, motion, found):
    held = {"status": NOT}
    monkeypatch.setattr(choice, "_known", lambda *_: (None, Blind(motion, END, **held)))
    sought = []

    def seek(*_):
        sought.append(1)
        return found

    monkeypatch.setattr(choice.ByFormula, "sought", seek)
    assert choice.understand(motion, END).explanation is found
    held["status"] = EXPLAINED
    assert isinstance(choice.understand(motion, END).explanation, Blind) and len(sought) == 1
    held["status"] = NOT
    monkeypatch.setattr(choice.ByFormula, "sought", lambda *_: "no formula: it is late")
    answer = choice.understand(motion, END)
    assert isinstance(answer.explanation, Blind) and answer.no_formula == "no formula: it is late"


def test_a_law_whose_force_is_not_quite_the_body_s_gives_way_to_a_formula_that_foretells_more(
    monkeypatch, motion, found
):
    """In the last frames that both were fitted to; what was held out has no say."""
    own = found.rehearsals[0].tail.errors["model"]
    assert 0 < own < 0.1
    for before, held_out, told in ((2 * own, 0.0, True), (1.1 * own, 1.0, False)):
        bent = Foretelling(motion, END, before, held_out, bent=True)
        monkeypatch.setattr(choice, "_known", lambda *_, bent=bent: (None, bent))
        monkeypatch.setattr(choice.ByFormula, "sought", lambda *_: found)
        answer = choice.understand(motion, END)
        assert answer.explanation is (found if told else bent)
        assert ("foretell" in answer.no_formula) is not told


def made(*words_with_numbers):
    """A formula of words: name, coefficient, constants."""
    known = {term.name: term for term in words(positive=False)}
    names, sizes, constants = zip(*words_with_numbers, strict=True)
    errors = (0.01,) * (len(names) + sum(len(part) for part in constants))
    return Formula(tuple(known[n] for n in names), constants, tuple((s,) for s in sizes), errors)


def test_a_model_carries_cubics_and_sines_and_nothing_else():
    sine = made(("sin", -2.0, (3.0,)), ("x^2", -0.5, ()))
    pendulum, well = _potentials(sine)
    assert isinstance(pendulum, Pendulum) and isinstance(well, Well)
    q = torch.tensor([[0.7]], dtype=torch.float64)
    told = -pendulum.rate2 * pendulum.length * np.sin(0.7 / pendulum.length) + well.second * 0.49
    assert told == pytest.approx(sine.at(q.numpy()[0])[0], rel=1e-4)
    assert _potentials(made(("tanh", -2.0, (3.0,)))) is None


def test_a_model_carries_frictions_and_one_that_changes_with_the_place():
    assert _ports({"v": -0.2, "sgn(v)": -0.1}) == (
        terms.Drag("linear", "positive", rate=0.2),
        terms.Drag("dry", "positive", rate=0.1),
    )
    assert _ports({"v": 1.2, "x^2 v": -1.1}) == (terms.PlacewiseFriction((-1.2, 0.0, 1.1)),)
    assert _ports({"v": 0.1}) == (terms.Drag("linear", "free", rate=-0.1),)
    assert _ports({"v^3": -0.1}) is None and _ports({"x v": 0.1, "sgn(v)": -0.2}) is None


def test_a_refusal_says_how_far_a_recording_must_reach_to_tell():
    cubic = made(("x", 1.0, ()), ("x^3", -1 / 6, ()))
    sine = made(("sin", 1.0, (1.0,)))
    told = would_tell(Judged(None, ALIKE, (sine, cubic)), -1.2, 1.5)
    place = float(told.split("that reaches ")[1].split(";")[0].split(" would")[0])
    assert 1.5 < abs(place) < 3.5
    apart = abs(float(np.sin(place) - (place - place**3 / 6)))
    assert apart == pytest.approx(0.2 * np.std(np.sin(X)), rel=0.5)
