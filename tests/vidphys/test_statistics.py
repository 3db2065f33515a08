"""H1-H7 against figures that can be checked by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vidphys.statistics import (
    RatioBar,
    binomial_p,
    holm,
    normal_interval,
    ordering,
    paired_difference,
    sign_flip_p,
    spearman,
)


def test_binomial_of_ten_in_ten_is_the_studys_figure():
    assert binomial_p(10, 10) == pytest.approx(2**-10)
    assert binomial_p(0, 10) == pytest.approx(1.0)
    assert binomial_p(2, 3) == pytest.approx(0.5)


@pytest.mark.parametrize(("successes", "seeds"), [(4, 3), (-1, 3), (0, 0)])
def test_binomial_refuses_impossible_counts(successes, seeds):
    with pytest.raises(ValueError, match="binomial_p"):
        binomial_p(successes, seeds)


def test_sign_flip_of_twelve_equal_signs_is_two_in_4096():
    first = np.arange(1.0, 13.0)
    assert sign_flip_p(first, np.zeros(12)) == pytest.approx(2 / 2**12)
    # The study's Holm p of about 0.003 is a family of six of these.
    assert holm([2 / 2**12] * 6)[0] == pytest.approx(0.00293, abs=1e-5)


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=8))
def test_sign_flip_is_symmetric_and_a_probability(differences):
    zero = [0.0] * len(differences)
    p = sign_flip_p(differences, zero)
    assert 2 ** (1 - len(differences)) - 1e-12 <= p <= 1
    assert p == sign_flip_p(zero, differences)


def test_holm_steps_down_and_never_decreases():
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.8]) == [1.0, 1.0]


def test_interval_is_given_from_five_values_on_and_labelled():
    four = normal_interval([1.0, 2.0, 3.0, 4.0])
    assert (four.mean, four.low, four.high) == (2.5, None, None)
    five = normal_interval([1.0, 2.0, 3.0, 4.0, 5.0])
    half = 1.96 * math.sqrt(2.5 / 5)
    assert (five.low, five.high) == pytest.approx((3 - half, 3 + half))
    assert five.method == "normal-approximation"


def test_paired_difference_removes_what_pairs_share():
    rng = np.random.default_rng(0)
    shared = rng.normal(size=12) * 100
    first, second = shared + 1 + 0.1 * rng.normal(size=12), shared
    interval = paired_difference(first, second)
    assert 0.8 < interval.low < interval.mean < interval.high < 1.2
    with pytest.raises(ValueError, match="paired_difference"):
        paired_difference([1.0], [])


def test_spearman_sees_ranks_only():
    x = [1.0, 2.0, 3.0, 4.0, 5.0]
    assert spearman(x, np.exp(x)) == pytest.approx(1)
    assert spearman(x, [-v for v in x]) == pytest.approx(-1)
    # By hand: one exchange of neighbours among five, 1 - 6 * 2 / (5 * 24).
    assert spearman(x, [1, 3, 2, 4, 5]) == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ([1, 2], [1, 2], "three or more"),
        ([1, 2, 3], [1, 2], "three or more"),
        ([1, 2, math.nan], [1, 2, 3], "not finite"),
        ([1, 1, 1], [1, 2, 3], "constant"),
    ],
)
def test_spearman_refuses_what_has_no_ranks(x, y, message):
    with pytest.raises(ValueError, match=message):
        spearman(x, y)


def test_ordering_counts_seeds_and_ties_do_not_count():
    five = ordering([1, 1, 1, 1, 1], [2, 2, 2, 2, 2])
    assert (five.ordered, five.seeds) == (5, 5)
    assert five.p == pytest.approx(2**-5)  # the study's 0.031
    assert ordering([1, 2], [1, 3]).ordered == 1
    with pytest.raises(ValueError, match="ordering"):
        ordering([], [])


def test_a_ratio_bar_asks_every_seed():
    bar = RatioBar(2.0)
    assert bar.holds([2.0, 5.0], [1.0, 2.0])
    assert not bar.holds([2.0, 3.9], [1.0, 2.0])
    assert not bar.holds([math.nan], [1.0])
    with pytest.raises(ValueError, match="at_least must be > 0"):
        RatioBar(0.0)
    with pytest.raises(ValueError, match="RatioBar: got 1 and 2"):
        bar.holds([1.0], [1.0, 2.0])
