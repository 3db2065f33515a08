"""A formula that was found, as a person reads it; and when none is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from vidphys.diagnose.formula.grammar import Term
from vidphys.diagnose.formula.search import search
from vidphys.diagnose.formula.sums import Force, Samples, Sum, design
from vidphys.statistics import NORMAL_95

# nats by which rivals must be worse, and by which ones must be whose word is a wider one of a sum's
MARGIN, WIDER = 5.0, 1.0
LIMIT = 3.5  # the same of a product with a slow sine, each number of which is clear
ODDS = 0.5  # of all rivals together against a formula, from which it does not stand out
CHANCE = 0.1  # that numbers of no use let a rival fit so much better
STRANGE = 1e-3  # chance of so large a misfit, below which no formula of the grammar is believed
CLEAR = 3.0  # times its error, that a coefficient differs from zero
TINY = 1e-100
ALIKE = "no formula: several fit alike"
TOLD = 3  # rivals that are told


@dataclass(frozen=True)
class Formula(Force):
    """A sum of words with numbers.

    Args:
        terms, constants, coefficients: of :class:`Force`.
        errors: standard errors: of all coefficients in their order, then of all constants.
        variable: its name.
    """

    errors: tuple[float, ...]
    variable: str = "x"

    @property
    def numbers(self) -> tuple[tuple[float, float, float], ...]:
        """Value and 95 % interval of each number: the coefficients, then the constants."""
        flat = [v for part in (*self.coefficients, *self.constants) for v in part]
        return tuple(
            (value, value - NORMAL_95 * error, value + NORMAL_95 * error)
            for value, error in zip(flat, self.errors, strict=True)
        )

    @property
    def text(self) -> str:
        """As one writes it: ``2.31 x + 0.54 x^3``."""
        errors = iter(self.errors)
        known = [[next(errors) for _ in part] for part in self.coefficients]
        free = [[next(errors) for _ in part] for part in self.constants]
        parts = [
            _said(*each)
            for each in zip(self.terms, self.coefficients, self.constants, known, free, strict=True)
        ]
        whole = " + ".join(parts).replace("+ -", "- ")
        return whole if self.variable == "x" else _renamed(whole, self.variable)


@dataclass(frozen=True)
class Verdict:
    """A formula or why there is none.

    Args:
        formula: ``None`` where none stands out.
        why: one sentence.
        rivals: formulas that fit alike, the best first.
    """

    formula: Formula | None
    why: str
    rivals: tuple[Formula, ...] = ()


def formula_of(x: np.ndarray, f: np.ndarray, error: np.ndarray | float) -> Formula | None:
    """The short formula of a force, where one stands out.

    Args:
        x: places, ``(m,)``.
        f: values of the force there, ``(m,)``.
        error: their standard errors, ``(m,)`` or one for all; above zero.

    Returns:
        The formula; ``None`` where none of the grammar fits, or several fit alike.

    Raises:
        ValueError: arrays of other shapes, fewer than eight values, or errors that are not
            positive.

    Example:
        >>> x = np.linspace(-1.5, 1.5, 40)
        >>> found = formula_of(x, 2.3 * x + 0.54 * x**3, 0.005)
        >>> found.text
        '2.3 x + 0.54 x^3'
    """
    return verdict_of(x, f, error).formula


def verdict_of(x: np.ndarray, f: np.ndarray, error: np.ndarray | float) -> Verdict:
    """As :func:`formula_of`, with the reason and the rivals."""
    x, f = np.asarray(x, float), np.asarray(f, float)
    error = np.broadcast_to(np.asarray(error, float), x.shape)
    if x.ndim != 1 or f.shape != x.shape or len(x) < 8:
        raise ValueError(
            f"formula_of: needs x and f of one shape (m >= 8,), got {x.shape, f.shape}"
        )
    if not (error > 0).all():
        raise ValueError("formula_of: errors must be above zero; give those of the values")
    samples = Samples(x, f, np.diag(1 / error), len(x))
    found = [with_errors(one, samples) for one in search(samples)[:20]]
    limit = [chdtri(max(len(x) - one.numbers, 1), STRANGE) for one, _ in found]
    return chosen([(one, formula, one.misfit < most)
                   for (one, formula), most in zip(found, limit, strict=True)])  # fmt: skip


def with_errors(one: Sum, samples: Samples) -> tuple[Sum, Formula]:
    """A sum as a formula: the errors of its numbers by their curvature."""
    flat = np.concatenate([*one.coefficients, *one.constants])
    count = sum(len(part) for part in one.coefficients)
    cuts = np.cumsum([len(part) for part in (*one.coefficients, *one.constants)])[:-1]

    def at(numbers: np.ndarray) -> np.ndarray:
        parts = [tuple(part) for part in np.split(numbers, cuts)]
        columns = design(one.terms, parts[len(one.terms) :], samples.x)
        return samples.white @ (columns @ numbers[:count])

    nudge = 1e-5 * (np.abs(flat) + 1e-3)
    base = at(flat)
    jacobian = np.stack(
        [(at(flat + n * e) - base) / n for n, e in zip(nudge, np.eye(len(flat)), strict=True)], -1
    )
    errors = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)))
    return one, Formula(one.terms, one.constants, one.coefficients, tuple(errors))


def chosen(found: Sequence[tuple[Sum, Formula, bool]]) -> Verdict:
    """The formula that stands out, or none.

    Args:
        found: sums, as formulas, and whether each leaves no more than noise.
    """
    fitting = sorted((each for each in found if each[2]), key=lambda each: each[0].score)
    sure = [each for each in fitting if clear(each[1])]
    if not sure:
        return Verdict(None, "no formula: none of the grammar fits to within the noise")
    best, formula, _ = sure[0]
    rivals = [
        other
        for one, other, _ in fitting
        if one is not best and _near(best, one, other) and _told(best, one, other)
    ]
    rivals = rivals or _together_as_likely(best, fitting)
    if rivals:
        return Verdict(None, ALIKE, (formula, *rivals[:TOLD]))
    return Verdict(formula, "a formula stands out")


def _together_as_likely(best: Sum, fitting: Sequence[tuple[Sum, Formula, bool]]) -> list[Formula]:
    """The other formulas whose words all count, where many that are each less likely add up.

    Those that only add a word to the best are it, in effect.
    """
    others = [
        (np.exp(best.score - one.score), other)
        for one, other, _ in fitting
        if one is not best and not set(one.kind) > set(best.kind) and clear(other)
    ]
    return [other for _, other in others] if sum(odds for odds, _ in others) > ODDS else []


def _near(best: Sum, one: Sum, other: Formula) -> bool:
    """Whether a rival is so near that nothing tells which of the two it is.

    One with more numbers always fits better; it is near where it does so by more than chance.
    """
    worse, more = one.score - best.score, one.numbers - best.numbers
    if more <= 0:
        return worse < MARGIN
    own = [term for term in best.terms if term not in one.terms]
    wide = [term for term in one.terms if term not in best.terms]
    if all(any(_among(a, b) for b in wide) for a in own):
        return worse < WIDER
    if all(any(_slow(a, b) for b in wide) for a in own):
        return worse < (LIMIT if clear(other) else WIDER)
    return worse < MARGIN and best.misfit - one.misfit > chdtri(more, CHANCE)


def _among(word: Term, wide: Term) -> bool:
    """Whether a word is another at some constant: a sine is a wave."""
    if wide.name == "wave":
        return word.name in ("sin", "cos")
    return wide.degree is None and word.power is not None


def _slow(word: Term, wide: Term) -> bool:
    """Whether a word is a product whose sine is slow: ``x exp`` is ``exp sin``, in the limit."""
    return wide.name == f"{word.name.removeprefix('x ')} sin" and word.name.startswith("x ")


def _told(best: Sum, one: Sum, other: Formula) -> bool:
    """Whether a rival counts: with more numbers the data need not tell each of them."""
    return one.numbers > best.numbers or clear(other)


def clear(formula: Formula) -> bool:
    """Whether every word counts: its size, and each constant, is clear of zero."""
    flat = iter(zip(formula.numbers, formula.errors, strict=True))
    sizes = [[next(flat) for _ in part] for part in formula.coefficients]
    words = [
        sum((value / max(error, TINY)) ** 2 for (value, *_), error in each) / len(each)
        for each in sizes
    ]
    rest = [(value / max(error, TINY)) ** 2 for (value, *_), error in flat]
    return min([*words, *rest]) > CLEAR**2


def _said(
    term: Term,
    coefficients: Sequence[float],
    constants: Sequence[float],
    errors: Sequence[float],
    constant_errors: Sequence[float],
) -> str:
    """A word with its numbers, to as many digits as they are known."""
    numbers = [_digits(v, e) for v, e in zip(constants, constant_errors, strict=True)]
    front = _digits(coefficients[0], errors[0])
    if len(coefficients) == 2:  # a wave
        size = float(np.hypot(coefficients[0], coefficients[1]))
        phase = float(np.arctan2(coefficients[1], coefficients[0]))
        front, numbers = _digits(size, max(errors)), [*numbers, _digits(phase, max(errors) / size)]
    word = term.text.format(*numbers).replace("--", "").replace("- -", "+ ")
    return front if term.name == "1" else f"{front} {word}"


def _digits(value: float, error: float) -> str:
    """A number to the second digit of its error."""
    if not (np.isfinite(error) and error > 0) or value == 0:
        return f"{value:.4g}"
    digits = int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(error)) + 2, 1, 6))
    return f"{value:.{digits}g}"


def _renamed(text: str, variable: str) -> str:
    """Another letter for x; words that have an x in them are left alone."""
    return text.replace("exp", "e_p").replace("x", variable).replace("e_p", "exp")
