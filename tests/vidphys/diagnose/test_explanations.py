"""What explains a motion is chosen at one place, and one more is a class and an entry there."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dynamics import terms
from tests.vidphys.diagnose.test_diagnose import seen
from tests.vidphys.diagnose.test_mechanisms import noisy, thrown
from vidphys.diagnose.explanations import choice
from vidphys.diagnose.explanations.explanation import Explanation, Oscillation
from vidphys.diagnose.explanations.forecast import State, beside_simple, roll
from vidphys.diagnose.explanations.law_words import number
from vidphys.diagnose.explanations.menu import ByMenu
from vidphys.diagnose.explanations.specification import as_specification
from vidphys.diagnose.explanations.verdict import MOSTLY, Verdict
from vidphys.diagnose.inference.linearised import sure_modes
from vidphys.diagnose.inference.menu import FRICTIONS, external_terms, pair_term
from vidphys.diagnose.inference.refine import Fitted
from vidphys.diagnose.inference.structures import Structure
from vidphys.diagnose.mechanisms.impacts.strikes import strikes
from vidphys.diagnose.mechanisms.quantities import Quantity
from vidphys.diagnose.recordings.motion import Motion, motion_of
from vidphys.diagnose.recordings.units import Units
from vidphys.diagnose.telling.answers import answer
from vidphys.diagnose.weak.spectrum import Mode


@dataclass(frozen=True)
class Oracle(Explanation):
    """One that knows the recording by heart."""

    motion: Motion
    end: int

    @classmethod
    def of(cls, motion, end, *_):
        return cls(motion, end)

    kinds = ["miracle"]
    fastest = 2.0

    def lines(self):
        return ["It was foreseen."]

    def data(self):
        return {"miracle": {"since": self.end}}

    def numbers(self):
        return {"miracles": 1.0}

    def rolled_on(self):
        seen = self.motion.positions[0, self.end :]
        still = np.zeros(seen.shape[1:])
        start = State(0.0, still, still, np.ones(1))
        return beside_simple(seen, self.motion, self.end, start, still)

    def changed(self):
        return {"no miracle": (self.motion.times[0], self.motion.positions[0])}

    def specification(self):
        return as_specification(
            terms.Hamiltonian(potentials=(terms.NoPotential(),)),
            1,
            [0.0, 0.0],
            {},
            True,
            self.motion.interval,
        )


@dataclass(frozen=True)
class Swinging(Oracle):
    """One whose oscillation is known exactly, though a spectrum has it otherwise."""

    def oscillations(self):
        return [Oscillation(Mode(2.0, 0.25, 0.01, 0.002), Mode(2.1, 0.297), Mode(2.1, 0.297, 0.1))]


def test_what_is_said_of_an_oscillation_is_the_fit_with_interval_and_unit(monkeypatch):
    monkeypatch.setattr(choice, "FITTED", (lambda *_: None, Swinging.of))
    given = answer(thrown(), False, 0.3)
    (said,) = (line for line in given.lines if line.startswith("Oscillation"))
    assert said == (
        "Oscillation 1, about its rest: 2.0000 ± 0.0039 radians per second, its amplitude decays "
        "by 0.250 ± 0.020 per second (95 %)."
    )
    assert given.data["modes"][0]["spectrum_decay"] == 0.297


def test_errors_of_an_oscillation_are_those_of_the_numbers_that_make_it():
    stiffness, friction = 4.0, 0.5
    held, rubbed = external_terms(1, False)[1], FRICTIONS["linear"]
    values = np.array([stiffness, 0.0, friction])
    structure = Structure((held, rubbed), values, 0.0, 0.0)
    covariance = np.diag([0.04, 0.01, 0.02]) ** 2
    covariance[0, 2] = covariance[2, 0] = 0.3 * 0.04 * 0.02
    fitted = Fitted(structure, values, covariance, None, 0.0, 0, None)
    (mode,) = sure_modes(fitted, np.zeros((1, 1)), np.ones(1))
    omega = np.sqrt(stiffness - friction**2 / 4)
    assert (mode.frequency, mode.decay) == pytest.approx((omega, friction / 2), rel=1e-6)
    slope = np.array([1 / (2 * omega), 0.0, -friction / (4 * omega)])
    assert mode.frequency_error == pytest.approx(np.sqrt(slope @ covariance @ slope), rel=1e-4)
    assert mode.error == pytest.approx(0.02 / 2, rel=1e-4)


@dataclass(frozen=True)
class Foretelling(Oracle):
    """One that is off by so much over the last frames that it was fitted to, and those held out."""

    before: float
    held_out: float
    bent: bool = False

    def rolled_on(self):
        tail = super().rolled_on()
        return replace(tail, errors={**tail.errors, "model": self.held_out})

    def judged(self, tail):
        return Verdict(MOSTLY, 0.8, 1.0, 0.0, 1.0, bent=self.bent)

    def earlier(self):
        part = self.motion.cut(0, self.end)
        return [replace(self, motion=part, end=self.end // 2, held_out=self.before)]


def test_frames_that_are_held_out_have_no_say_in_which_explanation_is_chosen():
    motion = thrown()
    for held_out, other in ((0.0, 1.0), (1.0, 0.0)):
        for before, more in ((0.6, True), (0.8, False), (1.2, False)):
            menu = Foretelling(motion, 60, before, held_out)
            laws = Foretelling(motion, 60, 1.0, other)
            assert choice._foretells_more(menu, laws) is more


def test_one_more_explanation_is_told_and_written_as_the_others_are(monkeypatch):
    monkeypatch.setattr(choice, "FITTED", (lambda *_: None, Oracle.of))
    given = answer(thrown(), False, 0.3)
    at = given.lines.index("It was foreseen.")
    assert "it is off by 0 (persistence by " in given.lines[at + 1]
    assert "steps of 0.05 s" in given.lines[-1]
    assert given.data["miracle"] == {"since": 84}
    assert (given.data["terms"], given.data["explained"]) == (["miracle"], True)
    assert given.data["forecast_error"]["model"] == given.numbers["forecast_rmse_model"] == 0
    assert given.numbers["miracles"] == 1 and "modes" not in given.data
    assert list(given.rolled) == ["model", "no miracle"]
    assert given.specification["explained"] and given.specification["mass"] == [1.0]


def test_the_menu_is_asked_where_no_law_explains_all(monkeypatch):
    monkeypatch.setattr(choice, "FITTED", ())
    motion = seen("trap-drag", clips=1, bodies=1, frames=60)
    understood = choice.understand(motion, 48)
    told = understood.explanation
    assert understood.found.explained and isinstance(told, ByMenu)
    assert told.verdict is not None and told.verdict.horizon == told.verdict.held_out
    assert told.verdict.status == MOSTLY  # which of two frictions it is, is not certain
    assert any(line.startswith("Not certain") for line in told.lines())


def turned_round():
    """A body that goes straight on, and comes away from a wall faster than it came."""
    x = np.linspace(0, 2, 90)
    return np.stack([x, np.where(x < 1, -x, 1.6 * (x - 1) - 1)], -1)


def test_the_menu_which_has_no_walls_does_not_answer_about_what_is_struck(monkeypatch):
    monkeypatch.setattr(choice, "FITTED", ())
    understood = choice.understand(noisy(turned_round()), 90)
    assert understood.explanation is None
    assert understood.found.refused.startswith("something strikes the body at 1.4")


def test_a_body_that_another_one_turns_round_is_struck_by_nothing_unseen():
    one = turned_round()
    both = np.stack([one, 2 * one[45] - one], 1)  # the other meets it, and keeps the momentum
    assert strikes(noisy(both)) == []
    steady = np.linspace([0.0, 3.0], [0.5, 3.4], 90)
    away = np.stack([one, steady], 1)
    (struck,) = strikes(noisy(away))
    assert struck[0] == 0 and abs(struck[1] - 1.5) < 0.05


def test_of_several_trials_a_tail_is_held_out_too():
    times = np.arange(120) * 0.05
    trials = [a * np.exp(-0.05 * times) * np.cos(2 * times + b) for a, b in ((1, 0), (0.6, 1))]
    motion = noisy(np.array(trials[0])[:, None], 2e-3, 0.05)
    both = np.stack([motion.positions[0], trials[1][:, None, None]])
    both[1] += 2e-3 * np.random.default_rng(3).standard_normal(both[1].shape)
    both[0, 60:] = np.nan  # the first trial ended sooner: the other one is foretold
    for order in ([0, 1], [1, 0]):
        given = answer(motion_of(both[order], 0.05), False, 0.3)
        assert given.data["status"] == "explained" and given.data["terms"] == ["linear", "trap"]
        assert given.data["forecast_error"]["model"] < 0.01
        np.testing.assert_array_equal(given.positions, both[1])
        assert given.path is not None and abs(given.path[1] - both[1]).max() < 0.02


@pytest.mark.parametrize(("strength", "rolls"), [(1.0, True), (1e14, False)])
def test_terms_that_need_steps_far_shorter_than_a_frame_are_not_rolled_for_ever(strength, rolls):
    spring = Structure((pair_term("spring", None, "mass"),), np.array([strength]), 0.0, 0.0)
    q = np.array([[0.0, 0.0], [1.0, 0.0]])
    start = State(0.0, q, np.zeros_like(q), np.ones(2))
    times = np.linspace(0.1, 3.0, 30)
    if rolls:
        apart = np.ptp(roll(spring, start, times)[..., 0], axis=1)
        np.testing.assert_allclose(apart, np.abs(np.cos(2**0.5 * times)), atol=1e-5)
        return
    with pytest.raises(FloatingPointError, match="steps far shorter"):
        roll(spring, start, times)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (0.02, "length 0.350 ± 0.039 m (95 %)"),
        (0.077, "length: not told by this recording, between 0.2 and 0.5 m (95 %)"),
    ],
)
def test_a_number_is_told_or_else_the_limits_between_which_it_lies(error, said):
    assert number(Quantity("length", 0.35, error, 1), Units("m")) == said
