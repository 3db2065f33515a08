"""Formulas of forces: found where they stand out, refused where several fit alike."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vidphys.diagnose.formula.formula import Formula, Verdict, chosen, formula_of, verdict_of
from vidphys.diagnose.formula.grammar import words
from vidphys.diagnose.formula.laws import MOST, FoundLaw, borne_out, coordinate_law, law_of
from vidphys.diagnose.formula.search import search
from vidphys.diagnose.formula.shooting import Law, cut, fit_law
from vidphys.diagnose.formula.sums import Samples, Sum
from vidphys.diagnose.recordings.motion import motion_of
from vidphys.errors import InputError
from vidphys.experiments.formulas.laws import developed, drawn
from vidphys.experiments.formulas.table import EXACT, REFUSED, WRONG, judged

X = np.linspace(-1.5, 1.8, 60)
R = np.linspace(0.9, 2.5, 60)


def noisy(f, share=0.002):
    error = share * np.std(f)
    return f + error * np.random.default_rng(0).standard_normal(len(f)), error


@pytest.mark.parametrize(
    "x, f, kind, numbers",
    [
        pytest.param(X, -2.3 * X - 0.54 * X**3, ("x", "x^3"), (2.3, 0.54), marks=pytest.mark.slow),
        pytest.param(
            X, -np.sin(3 * X) - 0.5 * X, ("sin", "x"), (1.0, 0.5, 3.0), marks=pytest.mark.slow
        ),
        (X, -2 * np.sign(X) * np.abs(X) ** 1.37, ("sgn(x) |x|^p",), (2.0, 1.37)),
        pytest.param(R, R**-13 - R**-7, ("x^-13", "x^-7"), (1.0, 1.0), marks=pytest.mark.slow),
    ],
)
def test_the_formula_of_a_force_is_found_with_its_numbers(x, f, kind, numbers):
    values, error = noisy(f)
    found = formula_of(x, values, error)
    assert found is not None and found.kind == kind
    told = sorted(abs(value) for value, *_ in found.numbers)
    assert told == pytest.approx(sorted(numbers), rel=0.02)
    for value, low, high in found.numbers:
        assert low < value < high
        truth = min(numbers, key=lambda number: abs(number - abs(value)))
        assert low - (high - low) < np.sign(value) * truth < high + (high - low)
    np.testing.assert_allclose(found.at(x), f, atol=5 * error)


def test_what_is_told_is_written_as_a_physicist_does():
    x, cubed = (next(word for word in words(False) if word.name == n) for n in ("x", "x^3"))
    made = Formula((x, cubed), ((), ()), ((-2.3003,), (0.5402,)), (1e-2, 1e-2))
    assert made.text == "-2.3 x + 0.54 x^3"


@pytest.fixture(scope="module")
def vague():
    """Of a force that a sine fits, or a cubic."""
    return verdict_of(X, *noisy(np.sin(X), 0.03))


def test_no_formula_where_several_fit_or_none_does(vague):
    assert vague.formula is None
    steps = np.where(np.sin(9 * X) > 0, 1.0, -1.0)
    assert verdict_of(X, *noisy(steps)).why.startswith("no formula")
    with pytest.raises(ValueError, match="errors must be above zero"):
        formula_of(X, X, 0.0)


def told_of(name, score):
    """A sum of one word that fits, and is clear, as likely as its score says."""
    (term,) = (word for word in words(False) if word.name == name)
    constants = tuple(1.0 for _ in term.constants)
    made = Sum((term,), (constants,), ((2.0,),), 390.0, score)
    return made, Formula(made.terms, made.constants, made.coefficients, (0.1,) * made.numbers), True


def test_no_formula_where_many_that_are_each_less_likely_add_up():
    best, less = told_of("x", 10.0), [told_of(n, 11.5) for n in ("sin", "tanh", "atan", "soft1")]
    assert chosen([best, less[0]]).formula is best[1]
    assert chosen([best, *less]).formula is None


def test_a_word_is_not_told_for_its_product_with_a_slow_sine_that_is_as_likely():
    best = told_of("x gauss", 10.0)
    assert chosen([best, told_of("gauss sin", 12.5)]).formula is None
    assert chosen([best, told_of("gauss sin", 14.0)]).formula is best[1]
    assert chosen([best, told_of("exp sin", 12.5)]).formula is best[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "constants"), [("gauss cos", (3.68, 2.32)), ("exp sin", (2.81, 6.07))]
)
def test_a_word_that_is_found_only_beside_one_of_no_use_is_told_alone(name, constants):
    """From the grid of constants these are found with another word first, which then goes."""
    (term,) = (word for word in words(False) if word.name == name)
    x = np.linspace(-1.7, 2.1, 70)
    force = Sum((term,), (constants,), ((2.0,),), 0.0, 0.0).at(x)
    error = 0.002 * np.std(force)
    found = search(Samples(x, force, np.eye(len(x)) / error, 400))
    assert found[0].kind == (name,)


def test_words_of_a_positive_variable_are_defined_there():
    for positive, x in ((True, R), (False, X)):
        for term in words(positive):
            for of in term.columns:
                constants = tuple(np.array(0.7) for _ in term.constants)
                assert np.isfinite(of(x, constants)).all(), term.name


def pull(numbers, x):
    return np.stack([-numbers[0] * x, -x], -1)


def test_pieces_that_are_joined_know_numbers_far_better_than_pieces_apart():
    t = np.linspace(0, 20, 300)[None]
    places = np.exp(-0.05 * t) * np.cos(np.sqrt(4 - 0.05**2) * t)
    noise = 0.01 * np.random.default_rng(1).standard_normal(places.shape)
    pieces = cut(places + noise, t, 30, 2.0)
    starts = np.stack([np.nan_to_num(pieces.x[:, 0]), np.gradient(places[0], t[0])[::30]], -1)
    law = Law(pull, ("v",), -1.1, 1.1)
    apart = fit_law(law, np.array([3.5, 0.0]), starts, pieces)
    one = fit_law(law, apart.numbers, apart.starts[:1], pieces.joined())
    errors = 0.01 * np.sqrt(np.diag(one.inverse))
    assert (np.abs(one.numbers - [4.0, -0.1]) < 4 * errors).all() and errors.max() < 5e-3
    assert np.sqrt(np.diag(apart.inverse))[1] > 5 * np.sqrt(np.diag(one.inverse))[1]


def test_derivatives_of_a_roll_are_those_of_its_numbers_and_its_start():
    law = Law(pull, ("v", "sgn(v)"), -1.1, 1.1)
    times, numbers, start = np.linspace(0, 3, 40)[None], np.array([3.0, -0.2, -0.05]), [1.0, -0.3]
    flat = np.array([*numbers, *start])

    def places(flat):
        return law.roll(flat[:3], flat[None, 3:], times, 2)[0]

    rolled = places(flat)
    exact = np.cos(np.sqrt(4 - 0.1**2) * times[0])
    plain = Law(pull, ("v",), -1.1, 1.1).roll(np.array([4.0, -0.2]), flat[None, 3:] * 0 + [1, -0.1],
                                               times, 2)[0, :-1, 0]  # fmt: skip
    np.testing.assert_allclose(plain, np.exp(-0.1 * times[0]) * exact, atol=2e-3)
    for k in (0, 1, 3, 4):  # dry friction turns round with the speed, which has no derivative
        step = 1e-6 * np.eye(5)[k]
        by = (places(flat + step)[:-1, 0] - places(flat - step)[:-1, 0]) / 2e-6
        inside = np.abs(rolled[:-1, 0]) < 1.0
        np.testing.assert_allclose(rolled[inside[:10].nonzero()[0], 1 + k],
                                   by[inside[:10].nonzero()[0]], atol=1e-4)  # fmt: skip


def test_steps_lose_no_energy_that_a_friction_would_be_found_for():
    t = 0.63 * np.arange(1000)[None]  # ten frames a swing
    pieces = cut(np.cos(t), t, 1000, 1.0).joined()
    path = Law(pull, (), -1.1, 1.1).roll(
        np.array([1.0]), np.array([[1.0, 0.0]]), t, pieces.substeps
    )
    last = slice(-50, -1)
    columns = np.stack([np.cos(t[0, last]), np.sin(t[0, last])], -1)
    size = np.linalg.norm(np.linalg.lstsq(columns, path[0, last, 0], rcond=None)[0])
    assert size == pytest.approx(1.0, abs=8e-4)


def test_a_friction_that_changes_with_the_place_has_the_derivatives_of_its_path():
    law = Law(pull, ("v", "x v", "x^2 v"), -2.0, 2.0)
    times, flat = np.linspace(0, 3, 40)[None], np.array([3.0, 0.3, 0.2, -0.9, 1.0, -0.3])

    def places(flat):
        return law.roll(flat[:4], flat[None, 4:], times, 2)[0]

    rolled = places(flat)[:-1]
    for k, step in enumerate(1e-6 * np.eye(6)):
        by = (places(flat + step) - places(flat - step))[:-1, 0] / 2e-6
        np.testing.assert_allclose(rolled[:, 1 + k], by, atol=1e-5)


@pytest.fixture(scope="module")
def duffing():
    return coordinate_law(*developed()[0].recording(0))


def test_a_law_off_the_menu_is_found_from_noisy_places_with_its_friction(duffing):
    found = duffing
    assert found.verdict.formula.kind == ("x", "x^3")
    assert found.text.startswith("x'' = -2.3") and found.text.endswith("- 0.0501 x'")
    assert found.frictions == ("v",)
    ((name, rate, error),) = found.best.friction
    assert name == "v" and abs(rate + 0.05) < 4 * error < 0.01


def recorded(force, friction):
    """Ten swings or so, seen with noise."""
    times = np.linspace(0, 50, 400)
    places = solve_ivp(
        lambda t, s: [s[1], float(force(s[0])) - friction * s[1]],
        (0, 50), [1.3, 0.0], t_eval=times, rtol=1e-8, atol=1e-10,
    ).y[:1]  # fmt: skip
    noise = 0.005 * places.std() * np.random.default_rng(1).standard_normal(places.shape)
    return places + noise, times[None]


@pytest.mark.slow
def test_a_cusp_that_no_spline_follows_is_found_as_a_root():
    found = coordinate_law(*recorded(lambda x: -1.2 * np.sign(x) * np.abs(x) ** 0.5, 0.05))
    assert found.verdict.formula.kind == ("sgn(x) |x|^0.5",)
    assert found.frictions[0] == "v"


def test_an_oscillator_of_van_der_pol_s_has_a_friction_that_changes_with_the_place():
    times, middle = np.arange(0, 12, 1 / 40), 0.3

    def slope(_, y):
        away = y[0] - middle
        return [y[1], -9 * away + 0.8 * (1 - away**2 / 0.04) * y[1]]

    places = solve_ivp(slope, (0, 12), [middle + 0.1, 0], t_eval=times, rtol=1e-9).y[:1]
    noise = 0.002 * np.random.default_rng(0).standard_normal(places.shape)
    found = coordinate_law(places + noise, times[None])
    assert found.verdict.formula.kind == ("1", "x")
    truth = {"v": 0.8 - 20 * middle**2, "x v": 40 * middle, "x^2 v": -20.0}
    told = {word: (value, error) for word, value, error in found.best.friction}
    assert set(told) == set(truth)
    for word, (value, error) in told.items():
        assert abs(value - truth[word]) < 4 * error < 0.1 * abs(truth[word])
    assert "x^2 x'" in found.text


@pytest.mark.slow
def test_one_swing_over_and_over_is_no_formula_of_many_numbers():
    kinked = drawn(20_104, 13)[-1]  # a line and half a bump fit it to within the noise
    assert kinked.name == "kinked" and kinked.friction == 0
    refused = coordinate_law(*kinked.recording(116))
    assert refused.verdict.formula is None
    assert "the same swing over and over" in refused.text


def test_a_formula_of_many_numbers_is_not_told(duffing):
    bends = [word for word in words(False) if word.name in ("step", "gauss")]
    assert sum(word.numbers for word in bends) > MOST
    made = Formula(tuple(bends), ((2.0, 0.3), (1.0,)), ((1.0,), (1.0,)), (0.01,) * 5)
    assert "almost any force" in borne_out(Verdict(made, ""), duffing.spring).why
    assert borne_out(duffing.verdict, duffing.spring) is duffing.verdict


def test_a_pair_is_its_distance_and_other_motions_are_refused():
    with pytest.raises(InputError, match="pass each other"):
        law_of(motion_of(np.random.default_rng(0).normal(size=(1, 30, 2, 1)), 0.1))
    with pytest.raises(InputError, match="3 bodies in 2 dimensions"):
        law_of(motion_of(np.zeros((1, 30, 3, 2)), 0.1))


def test_laws_that_a_seed_draws_are_the_same_again_and_swing():
    one, again = drawn(5, 3), drawn(5, 3)
    assert [case.name for case in one] == [case.name for case in again]
    for case in one:
        places, times = case.recording(0)
        assert np.isfinite(places).all() and places.shape == times.shape


def test_another_formula_is_wrong_and_none_is_a_refusal(duffing, vague):
    case = next(case for case in developed() if case.name == "kinked")
    assert judged(case, duffing) == WRONG
    assert judged(developed()[0], duffing) == EXACT
    assert judged(replace(developed()[0], friction=0.0), duffing) == WRONG
    none = FoundLaw(vague, "")
    assert judged(case, none) == REFUSED
