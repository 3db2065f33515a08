"""Which terms: every combination of the menu is fitted, and the evidence for each is kept."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from vidphys.diagnose.inference.menu import FAMILIES, Field, Term
from vidphys.diagnose.weak.regression import Normal

PRICE = 1.5  # of each number, over Schwarz's half logarithm of the rows


@dataclass(frozen=True)
class Structure:
    """One combination of terms with its best coefficients.

    Args:
        terms: at most one of each family.
        coefficients: of all columns, in the order of the terms.
        score: log likelihood less the price of the numbers that were fitted.
        misfit: weighted mean square residual.
    """

    terms: tuple[Term, ...]
    coefficients: np.ndarray
    score: float
    misfit: float

    @property
    def kinds(self) -> frozenset[str]:
        """Kinds of the terms; a friction that adds energy is a drive."""
        return frozenset(
            "drive" if kind == "linear" and self.of(term)[0] < 0 else kind
            for term in self.terms
            for kind in term.kinds
        )

    @property
    def numbers(self) -> int:
        """How many were fitted."""
        return sum(term.size for term in self.terms)

    def of(self, term: Term) -> np.ndarray:
        """Coefficients of one of the terms."""
        at = 0
        for other in self.terms:
            if other is term:
                break
            at += len(other.coefficients)
        return self.coefficients[at : at + len(term.coefficients)]

    def term(self, family: str) -> Term | None:
        """The term of a family, if there is one."""
        return next((t for t in self.terms if t.family == family), None)

    def accelerations(self, field: Field) -> np.ndarray:
        """What the terms give together, ``(w, m, n, d)``."""
        total = np.zeros_like(field.q)
        for term in self.terms:
            total = total + term.columns(field) @ self.of(term)
        return total


@dataclass(frozen=True)
class Menu:
    """Terms to choose from and the place of each one's columns among all."""

    terms: tuple[Term, ...]

    @property
    def places(self) -> list[list[int]]:
        """Numbers of the columns of each term."""
        ends = np.cumsum([len(term.coefficients) for term in self.terms])
        return [
            list(range(end - len(term.coefficients), end))
            for term, end in zip(self.terms, ends, strict=True)
        ]

    def columns(self, field: Field) -> np.ndarray:
        """All columns, ``(w, m, n, d, p)``."""
        return np.concatenate([term.columns(field) for term in self.terms], -1)


def all_structures(menu: Menu, normal: Normal, floor: float, least: float = 0.0) -> list[Structure]:
    """Every combination, best first.

    Args:
        menu: the terms.
        normal: normal equations over their columns.
        floor: standard deviation below which a residual is numerical, world units.
        least: root mean square, world units, by which a term must move the rows to be told from
            what the integrals are wrong by; that error is systematic, and many rows do not
            average it away.
    """
    families: list[list[int | None]] = [
        [None, *(i for i, term in enumerate(menu.terms) if term.family == family)]
        for family in FAMILIES
    ]
    by_size: dict[int, list[list[int]]] = {}
    places = menu.places
    for combination in product(*families):
        chosen = [i for i in combination if i is not None]
        by_size.setdefault(sum(len(places[i]) for i in chosen), []).append(chosen)
    found = [
        structure
        for alike in by_size.values()
        for structure in _fits(menu, alike, normal, floor, least)
    ]
    return sorted(found, key=lambda s: -s.score)


def _fits(
    menu: Menu, combinations: list[list[int]], normal: Normal, floor: float, least: float
) -> Iterator[Structure]:
    """Combinations that have equally many columns, fitted together; those that stand."""
    places = menu.places
    columns = np.array([[k for i in chosen for k in places[i]] for chosen in combinations], int)
    solved = normal.solve_each(columns)
    misfits = normal.misfit_each(columns, solved)
    stand = ~_wrong(menu, columns, solved) & _show(menu, columns, solved, normal, least)
    for k in np.flatnonzero(stand):
        terms = tuple(menu.terms[i] for i in combinations[k])
        score = normal.log_likelihood(float(misfits[k]), floor)
        score -= price(normal.count, sum(term.size for term in terms))
        yield Structure(terms, solved[k], score, float(misfits[k]) / normal.count)


def price(rows: int, numbers: int) -> float:
    """What so many numbers that are fitted to so many rows cost, of log likelihood."""
    return float(PRICE * 0.5 * np.log(rows) * numbers)


def is_wrong(structure: Structure) -> bool:
    """Whether a number has a sign with which its term would not be what its name says."""
    solved = structure.coefficients[None]
    columns = np.arange(solved.shape[1])[None]
    return bool(_wrong(Menu(structure.terms), columns, solved)[0])


def _wrong(menu: Menu, columns: np.ndarray, solved: np.ndarray) -> np.ndarray:
    """See :func:`is_wrong`, of each of many choices of columns ``(k, c)``."""
    signed = [
        number < term.positive for term in menu.terms for number in range(len(term.coefficients))
    ]
    return (np.array(signed, bool)[columns] & (solved <= 0)).any(1)


def _show(
    menu: Menu, columns: np.ndarray, solved: np.ndarray, normal: Normal, least: float
) -> np.ndarray:
    """Whether each term of each of many choices moves the rows by at least so much, ``(k,)``."""
    whose = np.repeat(np.arange(len(menu.terms)), [len(term.coefficients) for term in menu.terms])
    own = whose[columns][:, :, None] == whose[columns][:, None, :]
    gram = normal.gram[columns[:, :, None], columns[:, None, :]]
    each = solved * (np.where(own, gram, 0.0) @ solved[..., None])[..., 0]
    moved = (own @ each[..., None])[..., 0] / normal.count
    return ~(moved < least**2).any(1)


def posterior(structures: Sequence[Structure]) -> dict[frozenset[str], float]:
    """Probability of each set of kinds: shapes and lengths of one kind are joined by the best."""
    best: dict[frozenset[str], float] = {}
    for structure in structures:
        best[structure.kinds] = max(best.get(structure.kinds, -np.inf), structure.score)
    top = max(best.values())
    weight = {kinds: float(np.exp(score - top)) for kinds, score in best.items()}
    total = sum(weight.values())
    return {kinds: value / total for kinds, value in weight.items()}


def chance(probability: dict[frozenset[str], float], kind: str) -> float:
    """Probability that a kind is among the terms."""
    return sum(value for kinds, value in probability.items() if kind in kinds)
