import numpy as np
import pytest

from vidphys.probing.choice import Place, choices_of, depths_of
from vidphys.probing.scores import Score, Sums

CLIPS = 60
HARD = np.random.default_rng(0).uniform(0.5, 1.5, CLIPS)


def place(layer, score, depth=0.0, cost=10.0, encoder="net", pixels=0.2, sure=True, noise=0.0):
    """A layer whose score is about this, clips being as hard as for any other layer."""
    drift = noise * np.random.default_rng(len(layer)).normal(size=CLIPS)
    sums = Sums((1 - score) * HARD + drift - drift.mean(), HARD)
    gain = score - pixels
    selectivity = Score(gain, gain - 0.1 if sure else -0.1, gain + 0.1)
    interval = Score(sums.score, sums.score - 0.05, sums.score + 0.05)
    controls = {"pixels": pixels, "random-weights": 0.1, "one-frame": 0.9}
    costs = Score(cost, cost, cost)
    return Place(
        encoder, layer, depth, "speed", interval, selectivity, controls, costs, sums, "cells"
    )


def test_the_best_layer_is_chosen_with_its_evidence():
    (choice,) = choices_of([place("1", 0.3), place("2", 0.8), place("3", 0.5)])
    assert (choice.encoder, choice.layer, choice.rival) == ("net", "2", "pixels")
    assert choice.sentence.startswith("for speed take net at layer 2 (read by cells, score 0.80 [")
    assert "best control pixels 0.20" in choice.sentence and "10 ms a clip" in choice.sentence


def test_what_only_takes_something_away_is_no_rival():
    """A frame alone may well know a position: that is no reason against the encoder."""
    (choice,) = choices_of([place("1", 0.8)])
    assert choice.rival_score == 0.2


def test_nothing_is_recommended_that_is_not_above_its_controls():
    (choice,) = choices_of([place("1", 0.25, sure=False)])
    assert "nothing here is surely above its controls" in choice.sentence
    assert "take" not in choice.sentence


def test_a_layer_that_is_above_its_controls_goes_before_a_better_one_that_is_not():
    (choice,) = choices_of([place("1", 0.8, sure=False), place("2", 0.7)])
    assert (choice.layer, choice.selectivity.value) == ("2", pytest.approx(0.5))
    assert choice.sentence.startswith("for speed take net at layer 2")


def test_what_is_above_its_controls_but_not_above_chance_is_not_known():
    weak = place("1", 0.04, pixels=-0.3)
    assert weak.selectivity.low > 0 > weak.score.low
    assert "nothing here is surely above" in choices_of([weak])[0].sentence


def test_a_cheaper_layer_that_is_not_surely_worse_is_named():
    alike = place("1", 0.78, cost=2.0, noise=0.5)
    (choice,) = choices_of([alike, place("22", 0.8, noise=0.5), place("0", 0.2, cost=1.0)])
    assert choice.cheaper[:2] == ("net", "1") and choice.cheaper[3] == 2.0
    assert "net at layer 1 is not surely worse" in choice.sentence
    worse = place("1", 0.6, cost=2.0)
    (choice,) = choices_of([worse, place("22", 0.8)])
    assert choice.cheaper is None


def test_the_front_has_what_nothing_beats():
    (choice,) = choices_of(
        [place("1", 0.3, cost=1.0), place("2", 0.2, cost=2.0), place("3", 0.8, cost=3.0)]
    )
    assert choice.front == (("net", "1"), ("net", "3"))


@pytest.mark.parametrize(
    ("scores", "verdict"),
    [((0.2, 0.8, 0.3), "shown"), ((0.2, 0.5, 0.9), "refuted"), ((0.2, 0.8, 0.6), "refuted")],
)
def test_the_middle_is_alone_where_no_other_layer_surely_knows_it(scores, verdict):
    layers = [
        place(str(k) * (k + 1), score, depth=k / 2, noise=0.3) for k, score in enumerate(scores)
    ]
    (found,) = depths_of(layers)
    assert found.verdict == verdict and verdict in found.sentence
    assert found.difference.low <= found.difference.value <= found.difference.high


def test_a_middle_that_is_hardly_better_is_not_alone():
    layers = [place("1", 0.1), place("22", 0.31, 0.5, noise=0.5), place("3", 0.3, 1.0, noise=0.5)]
    assert depths_of(layers)[0].verdict == "not decided"


def test_a_middle_that_is_not_above_its_controls_shows_nothing():
    layers = [place("1", 0.0), place("2", 0.3, 0.5, sure=False), place("3", 0.0, 1.0)]
    assert depths_of(layers)[0].verdict == "not decided"


def test_nothing_is_refuted_by_what_is_at_chance():
    layers = [place("1", 0.02), place("2", -0.3, 0.5), place("3", -0.4, 1.0)]
    assert depths_of(layers)[0].verdict == "not decided"


def test_an_encoder_without_a_middle_is_not_asked():
    assert depths_of([place("1", 0.1), place("2", 0.5, 1.0)]) == []
