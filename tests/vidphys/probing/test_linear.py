import numpy as np
import pytest
import torch

from vidphys.probing.linear import (
    STRENGTHS,
    Basis,
    exchanged,
    fold_of,
    inner_products,
    read_linearly,
)

CLIPS = np.repeat(np.arange(12), 2)


def problem(noise=0.1, size=6):
    rng = np.random.default_rng(0)
    features = rng.normal(size=(24, size))
    target = features @ rng.normal(size=(size, 2)) + 3 + noise * rng.normal(size=(24, 2))
    return features, target


def ridge(features, target, test, strength):
    """The plain solution, with an intercept."""
    mean, level = features.mean(0), target.mean(0)
    x, y = features - mean, target - level
    weights = np.linalg.solve(x.T @ x + strength * np.eye(x.shape[1]), x.T @ y)
    return level + (test - mean) @ weights


def test_predictions_are_those_of_a_ridge_regression():
    features, target = problem()
    train, test = np.arange(18), np.arange(18, 24)
    basis = Basis(features @ features.T, train, test, CLIPS)
    fitted = basis.fit(target[train])
    strength = fitted.strength / STRENGTHS[0] * basis.strengths[0]
    assert fitted.said == pytest.approx(
        ridge(features[train], target[train], features[test], strength)
    )


def test_the_strength_is_the_best_on_clips_left_out():
    """Held to the long way: each clip is left out, and the rest is fitted anew."""
    features, target = problem(noise=2.0, size=10)
    train = np.arange(18)
    basis = Basis(features @ features.T, train, np.arange(18, 24), CLIPS)
    fitted, errors = basis.fit(target[train]), []
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


def test_no_clip_is_predicted_by_what_saw_it():
    """Features that name the clip, and nothing else, say nothing of another clip."""
    products = (CLIPS[:, None] == CLIPS).astype(float)
    target = np.random.default_rng(0).normal(size=(12, 1)).repeat(2, 0)
    folds = fold_of(12, 4, 0)
    (said,) = read_linearly(products, [target], [np.ones(24, bool)], CLIPS, folds)
    assert said.raw == pytest.approx(said.constant, abs=1e-6)
    assert np.bincount(folds).tolist() == [3, 3, 3, 3]


def test_doubt_knows_where_the_noise_is():
    rng = np.random.default_rng(1)
    features = rng.normal(size=(600, 3))
    loud = np.exp(features[:, :1])
    target = features[:, 1:2] + loud * rng.normal(size=(600, 1))
    clips = np.arange(600) // 2
    known = np.ones(600, bool)
    (said,) = read_linearly(features @ features.T, [target], [known], clips, fold_of(300, 5, 0))
    assert np.corrcoef(np.log(said.doubt[:, 0]), features[:, 0])[0, 1] > 0.9
    assert np.sqrt(np.mean((said.raw - target) ** 2 / said.doubt**2)) == pytest.approx(1, abs=0.2)


def test_examples_that_are_not_known_do_not_teach():
    features, target = problem(noise=0.0)
    known = np.arange(24) % 5 != 0
    spoilt = np.where(known[:, None], target, np.nan)
    (said,) = read_linearly(features @ features.T, [spoilt], [known], CLIPS, fold_of(12, 4, 0))
    assert said.raw[known] == pytest.approx(target[known], abs=0.05)


def test_labels_are_exchanged_between_clips_as_a_whole():
    values = np.arange(24.0)[:, None]
    other = exchanged(values, CLIPS, 0)[:, 0]
    assert sorted(other) == sorted(values[:, 0]) and not np.array_equal(other, values[:, 0])
    assert np.all(np.diff(other.reshape(12, 2), axis=1) == 1)


def test_loud_channels_do_not_rule():
    values = torch.randn(8, 3, 2, 2, generator=torch.Generator().manual_seed(0))
    louder = values * torch.tensor([1.0, 1000.0, 1.0]).reshape(1, 3, 1, 1) + 5
    assert inner_products(louder[:, [0, 2, 1]]) == pytest.approx(
        inner_products(louder), rel=1e-4, abs=1e-5
    )
    alone = louder[:, 1:2]
    assert inner_products(alone) == pytest.approx(
        inner_products(values[:, 1:2]), rel=1e-3, abs=1e-4
    )
