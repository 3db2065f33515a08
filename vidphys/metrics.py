"""The study's metrics, and the two columns that a model with no force cannot pass.

Every summary carries how many episodes it is over and how many were not finite: a non-finite
episode is counted and never given a number. A summary over the others is no lie only beside that
count, which is why no bar is met where it flatters (``experiments/core/bars.py``).
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

from dynamics import PhaseState
from vidphys.summary import FAILED, INVALID, OK, Summary

ENERGY_NEAR_ZERO = 1e-3


def energy_drift(energy: Float[Tensor, "b t"], scale: Float[Tensor, " b"]) -> Float[Tensor, "b t"]:
    """Relative drift of the true energy, |E(t) - E(0)| / |E(0)|, ``(b, t)``.

    Args:
        energy: true energy of the predicted states, ``(b, t)``.
        scale: K + |V| of the start, ``(b,)``. Where |E(0)| < 1e-3 of it, the drift is taken
            relative to it instead, so that an energy near zero gives no infinity.

    Example:
        >>> energy = torch.tensor([[-2.0, -2.1, -1.9]])
        >>> [round(x, 3) for x in energy_drift(energy, scale=torch.tensor([4.0]))[0].tolist()]
        [0.0, 0.05, 0.05]
    """
    start = energy[:, :1].abs()
    scale = scale.unsqueeze(-1)
    return (energy - energy[:, :1]).abs() / torch.where(
        start < ENERGY_NEAR_ZERO * scale, scale, start
    )


VALID = 0.4  # of the truth's spread: an error below it is a valid prediction


def valid_time(
    prediction: PhaseState, reference: PhaseState, interval: float
) -> Float[Tensor, " b"]:
    """Valid prediction time of each episode: seconds until its error first exceeds 0.4.

    The error is the root mean square over (q, p), over the standard deviation of all channels of
    the reference (Pathak et al., "Hybrid forecasting of chaotic processes", 2018, whose threshold
    it is). What is not finite is not valid. An episode that is valid to the end has the whole time.

    Args:
        prediction, reference: ``(b, t, n, d)``, at the same moments.
        interval: seconds between them.

    Example:
        >>> q = torch.tensor([0.0, 1.0, 2.0]).reshape(1, 3, 1, 1)
        >>> truth = PhaseState(q, q)
        >>> valid_time(PhaseState(q * q, q * q), truth, interval=0.5).tolist()
        [0.5]
    """
    x, y = prediction.flat.double(), reference.flat.double()
    error = (x - y).square().mean(-1).sqrt() / _variance(y).sqrt()
    valid = (error <= VALID).long().cumprod(1).sum(1)  # leading moments that are
    return (valid - 1).clamp_min(0) * interval


def median(values: Float[Tensor, " b"]) -> Summary:
    """Median over the finite episodes of ``(b,)``; of an even number, midway between the two.

    Example:
        >>> median(torch.tensor([1.0, 2.0, 3.0, 6.0, torch.nan]))
        Summary(value=2.5, status='ok', episodes=5, nonfinite=1)
    """
    return _over_finite(values, lambda x: x.quantile(0.5))


def mean(values: Float[Tensor, " b"]) -> Summary:
    """Mean over the finite values of ``(b,)``."""
    return _over_finite(values, lambda x: x.mean())


def worst(values: Float[Tensor, " b"]) -> Summary:
    """Largest value over the finite episodes of ``(b,)``."""
    return _over_finite(values, lambda x: x.max())


def fraction_over_one(values: Float[Tensor, " b"]) -> Summary:
    """Share of the finite episodes of ``(b,)`` whose value exceeds 1."""
    return _over_finite(values, lambda x: (x > 1).double().mean())


def _over_finite(values: Tensor, reduce) -> Summary:  # noqa: ANN001 (a tensor function)
    finite = torch.isfinite(values)
    lost = int((~finite).sum())
    if lost == len(values):
        return Summary(None, FAILED, len(values), lost)
    return Summary.of(float(reduce(values[finite].double())), len(values), lost)


def auroc(positive: Float[Tensor, " b"], negative: Float[Tensor, " c"]) -> Summary:
    """Area under the receiver operating characteristic: how surely a value tells the two apart.

    It is the share of pairs, one of each, in which the positive one is larger; ties count half.

    Example:
        >>> auroc(torch.tensor([2.0, 3.0]), torch.tensor([1.0, 2.0])).value
        0.875
    """
    lost = int((~torch.isfinite(positive)).sum() + (~torch.isfinite(negative)).sum())
    apart = positive[torch.isfinite(positive), None].double() - negative[torch.isfinite(negative)]
    return _larger(apart, len(positive) + len(negative), lost)


def above(values: Float[Tensor, " b"], twins: Float[Tensor, " b"]) -> Summary:
    """Share of values that are larger than their own twin's; ties count half."""
    both = torch.isfinite(values) & torch.isfinite(twins)
    return _larger((values - twins)[both], len(values), int((~both).sum()))


def _larger(apart: Tensor, episodes: int, lost: int) -> Summary:
    if not apart.numel():
        return Summary(None, FAILED, episodes, lost)
    share = (apart > 0).double() + 0.5 * (apart == 0).double()
    return Summary.of(float(share.mean()), episodes, lost)


def slope(curves: Float[Tensor, "*b t"], duration: float) -> Float[Tensor, "*b"]:
    """Least-squares slope of each curve ``(..., t)`` against time, per unit of ``duration``."""
    time = torch.linspace(0, duration, curves.shape[-1], dtype=curves.dtype)
    time = time - time.mean()
    return (curves @ time) / time.square().sum()


RESAMPLES = 400


def median_slope_interval(curves: Float[Tensor, "b t"], duration: float) -> tuple[float, float]:
    """Bootstrap 95 % interval, over episodes, of the slope of the median of curves ``(b, t)``."""
    rng = torch.Generator().manual_seed(0)
    slopes = []
    for _ in range(RESAMPLES):
        chosen = torch.randint(len(curves), (len(curves),), generator=rng)
        slopes.append(slope(curves[chosen].quantile(0.5, 0), duration))
    found = torch.stack(slopes)
    return float(found.quantile(0.025)), float(found.quantile(0.975))


def nmse(prediction: PhaseState, reference: PhaseState) -> Summary:
    """Batch-pooled squared error over the reference's variance.

    States are ``(b, t, n, d)``. The variance is of all channels of (q, p) pooled, with one
    scalar mean removed. One non-finite episode makes the pooled number a failure.

    Example:
        >>> q = torch.tensor([0.0, 1.0, 2.0]).reshape(1, 3, 1, 1)
        >>> truth = PhaseState(q, q)
        >>> round(nmse(PhaseState(q + 0.1, q), truth).value, 4)
        0.0075
    """
    x, y = prediction.flat.double(), reference.flat.double()
    lost = int((~torch.isfinite(x).flatten(1).all(1)).sum())
    if lost:
        return Summary(None, FAILED, len(x), lost)
    return Summary.of(float((x - y).square().mean() / _variance(y)), len(x))


def episode_nmse(prediction: PhaseState, reference: PhaseState) -> Float[Tensor, " b"]:
    """The per-episode form of :func:`nmse` under the same pooled variance, ``(b,)``."""
    x, y = prediction.flat.double(), reference.flat.double()
    return (x - y).square().flatten(1).mean(1) / _variance(y)


def _variance(y: Tensor) -> Tensor:
    variance = y.var(correction=0)
    if not variance > 0:
        raise ValueError("nmse: the reference does not vary; its normalised error is undefined")
    return variance


def regime_match(prediction: PhaseState, flipped: PhaseState, trained: PhaseState) -> Summary:
    """1 if the rollout is strictly nearer to the flipped law's truth than to the trained
    law's, 0 otherwise; ties do not match; a non-finite rollout is a failure.

    Example:
        >>> q = torch.tensor([0.0, 1.0, 2.0]).reshape(1, 3, 1, 1)
        >>> attracted, repelled = PhaseState(-q, q), PhaseState(q, q)
        >>> regime_match(PhaseState(0.9 * q, q), repelled, attracted).value
        1.0
    """
    near, far = nmse(prediction, flipped), nmse(prediction, trained)
    if near.value is None or far.value is None:
        return near
    # Both distances in the same units: undo the two normalisations.
    d_flipped = near.value * float(_variance(flipped.flat.double()))
    d_trained = far.value * float(_variance(trained.flat.double()))
    return Summary(float(d_flipped < d_trained), OK, near.episodes, 0)


def gated_regime_match(match: Summary, error: Summary, ballistic: Summary) -> Summary:
    """The match of a rollout that beats the zero-force predictor; of any other, ``invalid``.

    Without the one error or the other there is no gate, and so no match.
    """
    if match.value is None:
        return match
    if error.value is None or ballistic.value is None:
        lost = max(error.nonfinite, ballistic.nonfinite)
        return Summary(None, FAILED, match.episodes, lost)
    if error.value >= ballistic.value:
        return Summary(None, INVALID, match.episodes, match.nonfinite)
    return match


def ratio(error: Summary, ballistic: Summary) -> Summary:
    """Ballistic skill: the error over the zero-force predictor's; < 0.5 to count.

    Without either, or over an error of zero, it is a failure.

    Example:
        >>> ratio(Summary(0.1, OK, 4, 0), Summary(None, FAILED, 4, 1))
        Summary(value=None, status='failed', episodes=4, nonfinite=1)
    """
    lost = max(error.nonfinite, ballistic.nonfinite)
    if error.value is None or not ballistic.value:
        return Summary(None, FAILED, error.episodes, lost)
    return Summary.of(error.value / ballistic.value, error.episodes, lost)


def cosine(model: Float[Tensor, "b *n d"], truth: Float[Tensor, "b *n d"]) -> Summary:
    """Cosine between two force batches ``(b, n, d)``, each taken as one long vector.

    Example:
        >>> force = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]])
        >>> round(cosine(-3 * force, force).value, 6)
        -1.0
    """
    x, y = model.double().flatten(1), truth.double().flatten(1)
    lost = int((~torch.isfinite(x).all(1)).sum())
    if lost:
        return Summary(None, FAILED, len(x), lost)
    norm = (x.norm() * y.norm()).clamp_min(torch.finfo(torch.float64).tiny)
    return Summary.of(float((x * y).sum() / norm), len(x))


def affine_residual(
    latent: Float[Tensor, "b features"], state: Float[Tensor, "b x"], fitted: int | None = None
) -> Summary:
    """What an affine map of the latent leaves unexplained, over the state's variance.

    Args:
        latent, state: ``(b, features)``.
        fitted: so many of the first episodes are what the map is fitted to, and it is scored on
            the others; half of them where it is not given. Few more than features say little.
    """
    fitted = len(latent) // 2 if fitted is None else fitted
    design = torch.cat([latent, torch.ones(len(latent), 1)], -1).double()
    lost = int((~torch.isfinite(design).all(1)).sum())
    if lost:
        return Summary(None, FAILED, len(latent), lost)
    known, asked = state[:fitted].double(), state[fitted:].double()
    weights = torch.linalg.lstsq(design[:fitted], known, driver="gelsd").solution
    error = (design[fitted:] @ weights - asked).square().mean()
    return Summary.of(float(error / asked.var(correction=0)), len(latent))


def latent_growth(states: PhaseState, steps: int) -> Summary:
    """Median over episodes of |z_T| / |z_0| after ``steps`` stored steps."""
    norm = states.flat.double().norm(dim=-1)
    return median(norm[:, steps] / norm[:, 0])
