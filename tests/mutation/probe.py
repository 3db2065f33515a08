"""What a rewritten tree calls: it turns one place round, and tries every tolerance smaller.

It lies at the root of the copy, so that the packages and the tests there share its state.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

FINEST = 16  # powers of ten by which a tolerance is tried to be tightened
WHOLE = (bool, int, np.integer)  # counts and indices have no sign to turn
USUAL = {torch.float64: (1e-7, 1e-7), torch.float32: (1.3e-6, 1e-5)}  # of torch.testing

active: int | None = None  # the sign or decision that is turned round
reached: set[int] = set()  # the places that were met since the set was last cleared
whole: set[int] = set()  # signs of counts and indices, which are no terms
room: dict[int, int] = {}  # tolerance -> powers of ten by which it could have been smaller


def flip(site: int, term: Any) -> Any:
    """The term, or its negative where this sign is the one that is turned round."""
    if isinstance(term, WHOLE):
        whole.add(site)
        return term
    reached.add(site)
    if active != site:
        return term
    return tuple(-part for part in term) if isinstance(term, tuple) else -term


def turn(site: int, answer: Any) -> Any:
    """The answer, or its opposite where this decision is the one that is turned round."""
    reached.add(site)
    if active != site:
        return answer
    return answer == 0 if isinstance(answer, torch.Tensor | np.ndarray) else not answer


def below(site: int, value: Any, bound: Callable[[float], Any], or_equal: bool) -> Any:
    """``value < bound(1)``, or ``<=``; also asked of the bound's smaller selves."""

    def within(scale: float) -> Any:
        return value <= bound(scale) if or_equal else value < bound(scale)

    _note(site, bound(1.0), torch.float64, within)
    return within(1.0)


def close(site: int, compare: Callable[..., Any], *values: Any, **options: Any) -> Any:
    """``torch.allclose`` or ``torch.testing.assert_close``; also asked of smaller tolerances."""
    dtype = getattr(values[0], "dtype", torch.float64)
    usual = USUAL.get(dtype, (0.0, 0.0)) if compare is not torch.allclose else (1e-5, 1e-8)
    wide = {
        name: default if options.get(name) is None else options[name]
        for name, default in zip(("rtol", "atol"), usual, strict=True)
    }

    def within(scale: float) -> bool:
        try:
            tight = {name: scale * size for name, size in wide.items()}
            return compare(*values, **{**options, **tight}) is not False
        except AssertionError:
            return False

    _note(site, max(wide.values()), dtype, within)
    return compare(*values, **options)


class approx:  # noqa: N801 (it stands for pytest's function)
    """``pytest.approx``; also asked of smaller tolerances."""

    __array_ufunc__ = None  # numpy leaves the comparison to this class
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, site: int, expected: Any, **told: Any) -> None:
        self.site, self.expected = site, expected
        self.told = told or {"rel": 1e-6, "abs": 1e-12}

    def _at(self, scale: float) -> Any:
        tight = {name: scale * size for name, size in self.told.items()}
        if "rel" in tight:
            tight.setdefault("abs", scale * 1e-12)
        return pytest.approx(self.expected, **tight)

    def __eq__(self, other: object) -> bool:
        size = max(self.told.values())
        _note(self.site, size, torch.float64, lambda scale: other == self._at(scale))
        return bool(other == self._at(1.0))

    def __repr__(self) -> str:
        return repr(self._at(1.0))


def _note(site: int, size: Any, dtype: torch.dtype, within: Callable[[float], Any]) -> None:
    """Keep by how much a tolerance of this size could have been smaller, where it was held to."""
    if not dtype.is_floating_point or not _all(within(1.0)):
        return
    # At sixteen units of rounding there is nothing to tighten.
    if float(torch.as_tensor(size).max()) <= 16 * torch.finfo(dtype).eps:
        return
    for power in range(1, FINEST + 1):
        if not _all(within(10.0**-power)):
            break
    else:
        power = FINEST + 1
    room[site] = min(room.get(site, FINEST), power - 1)


def _all(found: Any) -> bool:
    return bool(found.all()) if isinstance(found, torch.Tensor | np.ndarray) else bool(found)
