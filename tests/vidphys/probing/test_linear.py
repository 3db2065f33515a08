import numpy as np
import pytest
import torch

from vidphys.probing.folds import CrossValidation, Question, exchanged, fold_of
from vidphys.probing.linear import STRENGTHS, Basis, Seen, read_linearly, seen_as
from vidphys.probing.readouts import Linear, Local

CLIPS = np.repeat(np.arange(12), 2)


def problem(noise=0.1, size=6):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(24, size))
    target = features @ rng.normal(size=(size, 2)) + 3 + noise * rng.normal(size=(24, 2))
    return features, target


def seen(features):
    return Seen(features @ features.T, False)


def asked(*targets, clips=CLIPS, folds=4, known=None, classes=False, controls=False):
    """Targets ``(e, k)``, or ``(e, k, m)`` of classes."""
    known = np.ones(len(clips), bool) if known is None else known
    questions = [Question(t if classes else t[..., None], known, classes) for t in targets]
    return CrossValidation(questions, clips, fold_of(max(clips) + 1, folds, 0), 0, controls)


def ridge(features, target, test, strength):
    """The plain solution, with an intercept."""
    mean, level = features.mean(0), target.mean(0)
    x, y = features - mean, target - level
    weights = np.linalg.solve(x.T @ x + strength * np.eye(x.shape[1]), x.T @ y)
    return level + (test - mean) @ weights


def test_predictions_are_those_of_a_ridge_regression():
    features, target = problem()
    train, test = np.arange(18), np.arange(18, 24)
    basis = Basis(seen(features), train, test, CLIPS)
    (fitted,) = basis.fit([target[train]])
    strength = fitted.strength / STRENGTHS[0] * basis.strengths[0]
    assert fitted.said == pytest.approx(
        ridge(features[train], target[train], features[test], strength)
    )


def test_the_strength_is_the_best_on_clips_left_out():
    """Held to the long way: each clip is left out, and the rest is fitted anew."""
    features, target = problem(noise=2.0, size=10)
    train = np.arange(18)
    basis = Basis(seen(features), train, np.arange(18, 24), CLIPS)
    (fitted,), errors = basis.fit([target[train]]), []
    for strength in basis.strengths:
        residual = np.empty_like(target[train])
        for clip in range(9):
            out = CLIPS[train] == clip
            said = ridge(features[train][~out], target[train][~out], features[train][out], strength)
            residual[out] = target[train][out] - said
        errors.append((residual**2).sum())
        if strength == pytest.approx(fitted.strength / STRENGTHS[0] * basis.strengths[0]):
            assert fitted.left_out == pytest.approx(residual)
    assert STRENGTHS[int(np.argmin(errors))] == pytest.approx(fitted.strength)
    assert 0 < int(np.argmin(errors)) < len(STRENGTHS) - 1


def test_targets_that_are_fitted_together_are_fitted_as_alone():
    features, target = problem(noise=2.0, size=10)
    train = np.arange(18)
    basis = Basis(seen(features), train, np.arange(18, 24), CLIPS)
    noise = np.random.default_rng(1).normal(size=(18, 1))
    together = basis.fit([target[train], noise])
    for one, alone in zip(together, (target[train], noise), strict=True):
        (other,) = basis.fit([alone])
        assert (one.strength, one.said) == (other.strength, pytest.approx(other.said))
        assert one.left_out == pytest.approx(other.left_out)
        assert one.error == pytest.approx((one.left_out**2).sum())
    assert together[0].strength != together[1].strength


def test_no_clip_is_predicted_by_what_saw_it():
    """Features that name the clip, and nothing else, say nothing of another clip."""
    named = Seen((CLIPS[:, None] == CLIPS).astype(float), False)
    target = np.random.default_rng(0).normal(size=(12, 1)).repeat(2, 0)
    questions = asked(target)
    (said,) = read_linearly({"named": named}, questions)
    assert said.raw == pytest.approx(said.constant, abs=1e-6)
    assert np.bincount(questions.folds).tolist() == [3, 3, 3, 3]


def test_doubt_knows_where_the_noise_is():
    rng = np.random.default_rng(1)
    features = rng.normal(size=(600, 3))
    loud = np.exp(features[:, :1])
    target = features[:, 1:2] + loud * rng.normal(size=(600, 1))
    questions = asked(target, clips=np.arange(600) // 2, controls=True)
    (said,) = read_linearly({"features": seen(features)}, questions)
    assert np.corrcoef(np.log(said.doubt[:, 0, 0]), features[:, 0])[0, 1] > 0.9
    wrong = (said.raw[..., 0] - target) / said.doubt[..., 0]
    assert np.sqrt(np.mean(wrong**2)) == pytest.approx(1, abs=0.2)


def test_examples_that_are_not_known_do_not_teach():
    features, target = problem(noise=0.0)
    known = np.arange(24) % 5 != 0
    spoilt = np.where(known[:, None], target, np.nan)
    (said,) = read_linearly({"features": seen(features)}, asked(spoilt, known=known))
    assert said.raw[known][..., 0] == pytest.approx(target[known], abs=0.05)


def test_labels_are_exchanged_between_clips_as_a_whole():
    values = np.arange(24.0)[:, None]
    other = exchanged(values, CLIPS, 0)[:, 0]
    assert sorted(other) == sorted(values[:, 0]) and not np.array_equal(other, values[:, 0])
    assert np.all(np.diff(other.reshape(12, 2), axis=1) == 1)


def test_loud_channels_do_not_rule():
    values = torch.randn(8, 3, 2, 2, generator=torch.Generator().manual_seed(0))
    louder = values * torch.tensor([1.0, 1000.0, 1.0]).reshape(1, 3, 1, 1) + 5
    assert seen_as(louder).rows == pytest.approx(seen_as(values).rows, rel=1e-3, abs=1e-5)


def test_few_features_are_decomposed_by_themselves_and_say_the_same():
    features, target = problem(noise=1.0)
    train, test = np.arange(18), np.arange(18, 24)
    thin, full = (
        Basis(each, train, test, CLIPS) for each in (Seen(features, True), seen(features))
    )
    assert thin.vectors.shape == (18, 6) and full.vectors.shape == (18, 18)
    (one,), (other,) = thin.fit([target[train]]), full.fit([target[train]])
    assert one.strength == other.strength
    assert one.said == pytest.approx(other.said)
    assert one.left_out == pytest.approx(other.left_out)


def test_at_places_one_regression_serves_all_bodies():
    """Bodies lie where their speed is written; the third is read by what the others taught."""
    rng = np.random.default_rng(0)
    speed = rng.normal(size=(40, 3, 1))
    maps, places = torch.zeros(40, 2, 4, 4), torch.zeros(40, 3, 2)
    for clip in range(40):
        for body, cell in enumerate(rng.choice(16, 3, replace=False)):
            row, column = divmod(int(cell), 4)
            maps[clip, 0, row, column] = float(speed[clip, body, 0])
            places[clip, body] = torch.tensor([column - 1.5, 1.5 - row]) / 2
    clips, total = np.arange(40), speed.sum(1)
    each, together = Local(places)(maps, asked(speed[..., 0], total, clips=clips))
    assert each.raw.shape == speed.shape and each.raw == pytest.approx(speed, abs=0.02)
    assert together.raw[..., 0] == pytest.approx(total, abs=0.05)
    (elsewhere,) = Local(places.flip(1))(maps, asked(speed[..., 0], clips=clips))
    assert np.corrcoef(elsewhere.raw[:, 0, 0], speed[:, 0, 0])[0, 1] < 0.5


def test_each_target_takes_the_form_that_does_best():
    """A mean that drowns among 64 cells, the brightness of one cell, and the place of a blob."""
    rng = np.random.default_rng(0)
    maps = rng.normal(size=(80, 3, 8, 8))
    mean = 0.5 * rng.normal(size=80)
    maps[:, 0] += mean[:, None, None]
    bright = 20 * rng.normal(size=80)
    maps[:, 1, 2, 5] = bright
    columns = rng.integers(8, size=80)
    maps[np.arange(80), 2, rng.integers(8, size=80), columns] = 30
    targets = (mean[:, None], bright[:, None], columns[:, None] * 1.0)
    questions = asked(*targets, clips=np.arange(80))
    found = Linear()(torch.from_numpy(maps), questions)
    assert [each.forms.most_common(1) for each in found] == [
        [("pooled", 4)],
        [("cells", 4)],
        [("softmax", 4)],
    ]
    for said, true in zip(found, targets, strict=True):
        assert np.corrcoef(said.raw[:, 0, 0], true[:, 0])[0, 1] > 0.95
    alone = Linear(("cells",))(torch.from_numpy(maps), asked(targets[0], clips=np.arange(80)))
    wrong = [((said.raw[:, 0, 0] - mean) ** 2).mean() for said in (alone[0], found[0])]
    assert wrong[0] > 1.5 * wrong[1]


def test_classes_are_told_with_calibrated_probabilities():
    """Features that decide a class by a known chance, one class being rare."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(1200, 3))
    chance = 1 / (1 + np.exp(2 - 2 * features[:, 0]))
    true = (rng.uniform(size=1200) < chance).astype(int)
    coded = np.eye(2)[true][:, None]
    questions = asked(coded, clips=np.arange(1200) // 2, classes=True)
    (said,) = read_linearly({"features": seen(features)}, questions)
    assert said.raw.sum(-1) == pytest.approx(1)
    assert np.abs(said.raw[:, 0, 1] - chance).mean() < 0.03
