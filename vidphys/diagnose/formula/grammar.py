"""The words of a formula: powers, exponentials, waves, steps, and products of two of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

Column = Callable[[np.ndarray, Any], np.ndarray]  # of the variable, and of the constants
GRID, COARSE = 36, 11  # values that a constant is tried at first: of a word with one, with two
SLOW, FAST = 0.35, 14.0  # constants from first to last, times the reach of the variable
POWERS = (0.25, 6.0)  # exponents that are tried
PLAIN, USUAL, RARE, PRODUCT = 2.5, 4.5, 6.0, 7.0  # prices, in nats


@dataclass(frozen=True)
class Term:
    """A word, times a coefficient for each of its columns.

    Args:
        name: its kind, with which two formulas are compared.
        columns: functions of the variable and of the constants.
        constants: what each is: ``rate`` (one over the unit of x), ``place`` or ``power``.
        price: in nats, beside what its numbers cost.
        text: with ``{0}``, ``{1}`` for the constants; a word with two columns says itself anew.
        power: the exponent of a pure power, to tell it from one that is fitted.
        positive: whether it needs a variable above zero.
        degree: power of the length that its column counts in; ``None``: that of its constant.
        sharp: whether its slope jumps, or has no bound, at zero.
    """

    name: str
    columns: tuple[Column, ...]
    constants: tuple[str, ...]
    price: float
    text: str
    power: float | None = None
    positive: bool = False
    degree: float | None = 0.0
    sharp: bool = False

    @property
    def numbers(self) -> int:
        """Coefficients and constants."""
        return len(self.columns) + len(self.constants)


def signed(x: np.ndarray, power: np.ndarray | float) -> np.ndarray:
    """``sign(x) |x|^power``."""
    return np.sign(x) * np.maximum(np.abs(x), 1e-12) ** power


def _fixed(power: float, positive: bool) -> Term:
    whole = float(power).is_integer()
    plain = whole and 0 <= power <= 3
    price = PLAIN if plain else USUAL
    if whole and (power >= 0 or positive):
        name = "1" if power == 0 else "x" if power == 1 else f"x^{power:g}"
        return Term(name, (lambda x, p: x**power,), (), price, name, power, power < 0, power)
    name = f"x^{power:g}" if positive else f"sgn(x) |x|^{power:g}"
    column = lambda x, p: signed(x, power)  # noqa: E731
    return Term(name, (column,), (), USUAL, name, power, degree=power, sharp=power < 1)


def _one(name: str, of: Callable, text: str, constant: str = "rate", price: float = USUAL) -> Term:
    return Term(name, (lambda x, p: of(x, p[0]),), (constant,), price, text)


def _times(power: float, word: Term) -> Term:
    """A word times a power of x."""
    front = "x" if power == 1 else f"x^{power:g}"
    columns = tuple(
        lambda x, p, of=of: x**power * of(x, p)  # type: ignore[misc]
        for of in word.columns
    )
    name, text = f"{front} {word.name}", f"{front} {word.text}"
    positive = power < 0 or word.positive
    return Term(name, columns, word.constants, PRODUCT, text, None, positive, power)


def _both(one: Term, two: Term) -> Term:
    """A word times another, each with its constant."""
    a, b = one.columns[0], two.columns[0]
    text = f"{one.text} {two.text.replace('{0}', '{1}')}"
    column = lambda x, p: a(x, p[:1]) * b(x, p[1:])  # noqa: E731
    return Term(f"{one.name} {two.name}", (column,), ("rate", "rate"), PRODUCT, text)


EXP = _one("exp", lambda x, k: np.exp(np.clip(-k * x, -60, 60)), "exp(-{0} x)", "either")
GAUSS = _one("gauss", lambda x, k: np.exp(-0.5 * (k * x) ** 2), "exp(-({0} x)^2/2)")
SIN = _one("sin", lambda x, k: np.sin(k * x), "sin({0} x)")
COS = _one("cos", lambda x, k: np.cos(k * x), "cos({0} x)")
TANH = _one("tanh", lambda x, k: np.tanh(k * x), "tanh({0} x)")
ATAN = _one("atan", lambda x, k: np.arctan(k * x), "atan({0} x)", price=RARE)
LOG = Term("log", (lambda x, p: np.log(x),), (), USUAL, "log(x)", positive=True)
FREE = Term(
    "sgn(x) |x|^p",
    (lambda x, p: signed(x, p[0]),),
    ("power",),
    RARE,
    "sgn(x) |x|^{0}",
    degree=None,
    sharp=True,
)
FREE_POSITIVE = Term(
    "x^p", (lambda x, p: x ** p[0],), ("signed power",), RARE, "x^{0}", None, True, None
)
WAVE = Term(
    "wave",
    (lambda x, p: np.sin(p[0] * x), lambda x, p: np.cos(p[0] * x)),
    ("rate",),
    RARE,
    "sin({0} x + {1})",
)
SOFT = tuple(
    _one(
        f"soft{n}",
        lambda x, k, n=n: k * x / (1 + (k * x) ** 2) ** (n / 2),
        f"{{0}} x/(1 + ({{0}} x)^2)^{n / 2:g}" if n != 2 else "{0} x/(1 + ({0} x)^2)",
        price=RARE,
    )
    for n in (1, 2, 3)
)
HILL = _one("hill", lambda x, k: 1 / (1 + (k * x) ** 2), "1/(1 + ({0} x)^2)", price=RARE)
BUMP = Term(
    "bump",
    (lambda x, p: np.exp(-0.5 * (p[0] * (x - p[1])) ** 2),),
    ("rate", "place"),
    RARE,
    "exp(-({0} (x - {1}))^2/2)",
)
STEP = Term(
    "step",
    (lambda x, p: np.tanh(p[0] * (x - p[1])),),
    ("rate", "place"),
    RARE,
    "tanh({0} (x - {1}))",
)


@lru_cache(maxsize=2)
def words(positive: bool) -> tuple[Term, ...]:
    """All terms for a variable that stays above zero, or that does not."""
    powers = [_fixed(n, positive) for n in (0, 1, 2, 3, 4, 5, 7)]
    if positive:
        powers += [_fixed(n, True) for n in (-13, -7, -6, -4, -3, -2, -1, -0.5, 0.5, 1.5, 2.5)]
    else:
        powers += [_fixed(n, False) for n in (0.5, 1.5, 2.5)]
        powers += [_absolute(2.0), _absolute(1.0)]
    smooth = [EXP, GAUSS, SIN, COS, TANH, ATAN, *SOFT, HILL, BUMP, STEP, WAVE]
    products = [_times(1, word) for word in (EXP, GAUSS, SIN, COS, TANH)]
    products += [_times(2, word) for word in (EXP, GAUSS, COS, SIN)]
    products += [_times(3, GAUSS)]
    products += [_both(EXP, SIN), _both(EXP, COS), _both(GAUSS, SIN), _both(GAUSS, COS)]
    if positive:
        inverse = [_times(-1, word) for word in (EXP, SIN, COS, LOG, GAUSS)]
        inverse += [_times(-2, EXP), _times(1, LOG), _times(-2, LOG)]
        return (*powers, FREE_POSITIVE, LOG, *smooth, *products, *inverse)
    return (*powers, FREE, *smooth, *products)


def _absolute(power: float) -> Term:
    if power == 1:
        return Term("|x|", (lambda x, p: np.abs(x),), (), USUAL, "|x|", degree=1.0, sharp=True)
    return Term("x |x|", (lambda x, p: x * np.abs(x),), (), USUAL, "x |x|", power, degree=power)


def tries(term: Term, low: float, high: float) -> list[tuple[float, ...]]:
    """Values that the constants of a word are tried at, for a variable between two values."""
    reach = max(abs(low), abs(high))
    if not term.constants:
        return [()]
    count = GRID if len(term.constants) == 1 else COARSE
    rates = np.geomspace(SLOW, FAST, count) / reach
    values = {
        "rate": rates,
        "either": np.concatenate([-rates[::-1], rates]) * (1.0 if count == GRID else 0.6),
        "place": np.linspace(low, high, count + 2)[1:-1],
        "power": np.geomspace(*POWERS, count),
        "signed power": np.linspace(-8, 6, 2 * count),
    }
    grids = np.meshgrid(*(values[kind] for kind in term.constants), indexing="ij")
    return [tuple(point) for point in np.stack([g.ravel() for g in grids], -1)]


def bounds(term: Term, low: float, high: float) -> tuple[list[float], list[float]]:
    """Between which the constants of a word are believed."""
    reach = max(abs(low), abs(high))
    span = {
        "rate": (0.5 * SLOW / reach, 2 * FAST / reach),
        "either": (-2 * FAST / reach, 2 * FAST / reach),
        "place": (low - 0.5 * (high - low), high + 0.5 * (high - low)),
        "power": (0.5 * POWERS[0], 2 * POWERS[1]),
        "signed power": (-16.0, 12.0),
    }
    pairs = [span[kind] for kind in term.constants]
    return [a for a, _ in pairs], [b for _, b in pairs]
