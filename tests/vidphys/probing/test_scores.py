import numpy as np
import pytest

from vidphys.probing.coding import coded
from vidphys.probing.scores import Bootstrap, Sums, in_words, sums_of
from vidphys.probing.targets import Labels

RNG = np.random.default_rng(0)


def constant_of(labels):
    return np.broadcast_to(coded(labels).mean(0), coded(labels).shape)


@pytest.mark.parametrize("kind", ["regression", "circular", "classification"])
def test_perfect_is_one_and_chance_is_zero(kind):
    values = {
        "regression": RNG.normal(size=(3000, 2)),
        "circular": RNG.uniform(-np.pi, np.pi, (3000, 2)),
        "classification": RNG.choice([0.0, 1.0, 1.0, 1.0, 2.0], (3000, 2)),
    }[kind]
    labels = Labels("it", kind, "frame", values, ("a", "b", "c") if "class" in kind else ())
    raw, constant, clips = coded(labels), constant_of(labels), np.arange(3000) // 3
    alone = np.arange(1000)
    assert sums_of(labels, raw, constant, clips, alone).score == pytest.approx(1)
    assert sums_of(labels, raw[RNG.permutation(3000)], constant, clips, alone).score < 0.05
    assert sums_of(labels, constant, constant, clips, alone).score == pytest.approx(0, abs=0.05)


def test_an_angle_has_no_seam():
    labels = Labels("way", "circular", "frame", np.array([[np.pi - 0.1], [np.pi / 2]]))
    said = coded(Labels("way", "circular", "frame", np.array([[-np.pi + 0.1], [np.pi / 2]])))
    score = sums_of(labels, said, said, np.arange(2), np.arange(2)).score
    assert score == pytest.approx(1 - 0.1 / (np.pi / 2))
    assert in_words(labels, score) == "6 degrees off"


def test_what_a_clip_has_one_of_is_told_by_the_mean_of_its_frames():
    true = np.repeat(RNG.normal(size=(50, 1)), 4, 0)
    wrong = np.tile([1.0, -1.0, 2.0, -2.0], 50)[:, None]
    said, clips = (true + wrong)[..., None], np.arange(200) // 4
    score = {
        per: sums_of(labels, said, constant_of(labels), clips, np.arange(50)).score
        for per in ("clip", "frame")
        for labels in [Labels("mass", "regression", per, true)]
    }
    assert score["clip"] == pytest.approx(1) and score["frame"] < 0


def test_an_interval_by_clip_is_as_wide_as_clips_differ():
    """Frames of a clip that err together are no independent evidence."""
    clips, each = 100, 20
    together = RNG.exponential(size=clips)
    sums = Sums(each * together, np.full(clips, 2.0 * each))
    found = Bootstrap(clips).score(sums)
    spread = together.std() / 2 / np.sqrt(clips)
    assert (found.high - found.low) / (2 * 1.96) == pytest.approx(spread, rel=0.15)
    assert found.low < found.value < found.high


def test_a_difference_on_the_same_clips_is_sharper():
    hard = RNG.exponential(size=80)
    one, other = (Sums(hard + more, np.full(80, 2.0)) for more in (0.0, 0.1))
    draws = Bootstrap(80)
    difference = draws.difference(one, other)
    assert difference.low == pytest.approx(0.05) and difference.high == pytest.approx(0.05)
    assert draws.score(one).high - draws.score(one).low > 0.1
