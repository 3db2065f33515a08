"""What a checker says, and the comparisons that several of them make."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

STEP = 1e-6  # of a central difference in float64: its error is near 1e-10 of the slope
ALIKE = 1e-9  # relative, of what is computed twice in another order in float64
SLOPE = 1e-5  # relative, of a derivative against its central difference


class CheckFailed(AssertionError):
    """A part does not keep its contract: one line, what was expected and what came."""


def expect(good: bool, what: str, expected: object, got: object) -> None:
    """Refuse a part.

    Args:
        good: whether it is as expected.
        what: was looked at.
        expected, got: in words or numbers.

    Raises:
        CheckFailed: it is not.
    """
    if not good:
        raise CheckFailed(f"{what}: expected {expected}, got {got}")


def expect_same(a: Tensor, b: Tensor, what: str, expected: str, within: float = ALIKE) -> None:
    """Refuse tensors that differ by more than a share of the largest number in either."""
    expect(a.shape == b.shape, what, f"{expected}: shape {tuple(a.shape)}", tuple(b.shape))
    if not a.numel():
        return
    size = float(torch.maximum(a.abs().max(), b.abs().max()))
    away = float((a - b).abs().max())
    expect(away <= within * max(size, 1e-300), what, expected, f"a difference of {away:.2g}")


def slope_of(function: Callable[[Tensor], Tensor], x: Tensor) -> Tensor:
    """Gradient of the sum of a function's values; zero where it does not depend on ``x``."""
    given = x.detach().clone().requires_grad_(True)
    value = function(given).sum()
    if not value.requires_grad:
        return torch.zeros_like(x)
    (slope,) = torch.autograd.grad(value, given, allow_unused=True, materialize_grads=True)
    return slope


def expect_slope(function: Callable[[Tensor], Tensor], x: Tensor, what: str) -> None:
    """Refuse a function of float64 whose gradient is not that of its own values.

    Single precision on the way shows in the values, a cut gradient in the gradient.
    """
    rng = torch.Generator().manual_seed(1)
    along = torch.randn(x.shape, generator=rng, dtype=x.dtype)
    given = x.detach().clone().requires_grad_(True)
    value = function(given)
    weight = torch.randn(value.shape, generator=rng, dtype=value.dtype)
    expect(value.requires_grad, what, "a gradient that reaches the input", "none")
    (gradient,) = torch.autograd.grad((weight * value).sum(), given, allow_unused=True)
    slope = 0.0 if gradient is None else float((gradient * along).sum())
    with torch.no_grad():
        ahead, behind = (float((weight * function(x + s * along)).sum()) for s in (STEP, -STEP))
    measured = (ahead - behind) / (2 * STEP)
    size = max(abs(slope), abs(measured), 1e-4 * float(weight.abs().sum()))
    expect(
        abs(slope - measured) <= SLOPE * size,
        what,
        f"the gradient that its own float64 values have, {measured:.8g}",
        f"{slope:.8g} (single precision on the way, or a cut gradient)",
    )


def expect_spoiled(answer: Callable[[], Tensor], what: str) -> None:
    """Refuse a finite answer to what is not a number; an error of a line is as good as a NaN."""
    try:
        found = answer()
    except (ValueError, RuntimeError) as error:
        expect(bool(str(error)), what, "an error that says what is wrong", type(error).__name__)
        return
    finite = bool(torch.isfinite(found).all())
    expect(not finite, what, "a named error, or an answer that is not finite", "a finite answer")


def pickled(part: Any, what: str) -> Any:
    """A part as a worker process would be handed it."""
    try:
        return pickle.loads(pickle.dumps(part))
    except Exception as error:
        raise CheckFailed(f"{what}: expected to be pickled for a worker, got {error!r}") from error
