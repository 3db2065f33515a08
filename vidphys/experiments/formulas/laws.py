"""Laws of one coordinate off the menu, whose formula is known, as noisy recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special
from scipy.integrate import solve_ivp

from vidphys.diagnose.formula.grammar import Term, words

FRAMES, SWINGS, NOISE = 400, 10.0, 0.005  # noise as a share of the places' spread
LEAST = 0.15  # share of the force that each word has, at least, in a law that is drawn
OUTSIDE = 0.2  # share of the laws that are drawn outside the grammar
TRIES = 500
Force = Callable[[np.ndarray], np.ndarray]

STRANGE: dict[str, Force] = {
    "bessel": lambda x: -3 * special.j1(2 * x),
    "kinked": lambda x: -2 * x - 3 * np.maximum(x - 0.5, 0),
    "dead zone": lambda x: -3 * np.sign(x) * np.maximum(np.abs(x) - 0.4, 0),
    "erf": lambda x: -2 * special.erf(1.3 * x) - 0.4 * x**3,
    "teeth": lambda x: -x - 0.6 * np.arcsin(0.97 * np.sin(4 * x)),
    "deep power": lambda x: -2 * x / (1 + x**4) - 0.5 * x,
}


@dataclass(frozen=True)
class Case:
    """A law and a recording of it.

    Args:
        name: of the law.
        kind: names of its words, sorted; ``None`` outside the grammar.
        force: of the place, per unit of mass.
        friction: rate, per second.
        begin: place of the first frame, from rest.
        scale: seconds of a swing, about.
    """

    name: str
    kind: tuple[str, ...] | None
    force: Force
    friction: float
    begin: float
    scale: float

    def recording(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Noisy places and seconds, ``(1, frames)`` each."""
        times = np.linspace(0, SWINGS * self.scale, FRAMES)
        places = _rolled(self.force, self.friction, self.begin, times)
        noise = np.random.default_rng(seed).standard_normal(FRAMES)
        return (places + NOISE * places.std() * noise)[None], times[None]


def _rolled(force: Force, friction: float, begin: float, times: np.ndarray) -> np.ndarray:
    def rate(t: float, s: np.ndarray) -> list[float]:
        return [s[1], float(force(np.array(s[0]))) - friction * s[1]]

    far = 50 * abs(begin) + 50

    def away(t: float, s: np.ndarray) -> float:
        return far - abs(s[0])

    away.terminal = True  # type: ignore[attr-defined]
    ends = (float(times[0]), float(times[-1]))
    found = solve_ivp(rate, ends, [begin, 0.0], t_eval=times, rtol=1e-8, atol=1e-10, events=away)
    return found.y[0] if found.y.shape[1] == len(times) else np.full(len(times), np.nan)


def _made(
    name: str,
    kind: tuple[str, ...] | None,
    force: Force,
    begin: float,
    rub: float,
    positive: bool = False,
) -> Case:
    """A case, its swings counted by a roll.

    Raises:
        ValueError: from there nothing swings.
    """
    x = np.linspace(0.25 if positive else -4.0, 4.0, 2001)
    pull = force(x)
    climb = -np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * np.diff(x))])
    above = ~(climb <= np.interp(begin, x, climb) + 1e-9)
    left, right = np.flatnonzero(above & (x < begin)), np.flatnonzero(above & (x > begin))
    slope = float(force(np.array(begin)))
    if not np.isfinite(slope) or len(left if slope < 0 else right) == 0:
        raise ValueError("no swing")
    other = x[left[-1]] if slope < 0 else x[right[0]]
    if abs(other - begin) < 0.1 * abs(begin):
        raise ValueError("no swing")
    inside = np.linspace(min(begin, other), max(begin, other), 200)[1:-1]
    speed = 2 * (np.interp(begin, x, climb) - np.interp(inside, x, climb))
    about = 2 * float(np.sum(np.diff(inside)[0] / np.sqrt(np.maximum(speed, 1e-6))))
    if not 0.2 < about < 20:
        raise ValueError("no swing")
    return Case(name, kind, force, rub, begin, about)


def developed() -> list[Case]:
    """Laws to develop on, by hand."""
    laws = (
        ("duffing", ("x", "x^3"), lambda x: -2.3 * x - 0.54 * x**3, 1.8, 0.05),
        ("wave", ("sin", "x"), lambda x: -np.sin(3 * x) - 0.5 * x, 1.5, 0.0),
        ("lennard-jones", ("x^-13", "x^-7"), lambda x: 20 * (x**-13 - x**-7), 1.3, 0.0),
        ("soft step", ("tanh",), lambda x: -4 * np.tanh(2 * x), 1.5, 0.03),
        ("power", ("sgn(x) |x|^1.5",), lambda x: -3 * np.sign(x) * np.abs(x) ** 1.5, 1.5, 0.03),
        ("morse", ("exp", "exp"), lambda x: 2 * (np.exp(-2 * x) - np.exp(-x)), 1.2, 0.0),
        ("hole", ("x gauss",), lambda x: -4 * x * np.exp(-(x**2) / 1.28), 1.4, 0.02),
        ("two wells", ("x", "x^3"), lambda x: x - x**3, 1.6, 0.02),
        ("orbit", ("x^-2", "x^-3"), lambda x: 2 * x**-3.0 - 3 * x**-2.0, 1.2, 0.0),
        ("kinked", None, STRANGE["kinked"], 1.3, 0.0),
        ("bessel", None, STRANGE["bessel"], 1.3, 0.0),
    )
    return [
        _made(name, kind, force, begin, rub, name in ("lennard-jones", "orbit"))
        for name, kind, force, begin, rub in laws
    ]


def drawn(seed: int, count: int) -> list[Case]:
    """Laws that a seed draws, most from the grammar, some outside it.

    Each word has a part in the force; the motion swings and stays.
    """
    rng = np.random.default_rng(seed)
    out: list[Case] = []
    strange = list(STRANGE)
    while len(out) < count:
        outside = rng.random() < OUTSIDE
        for _ in range(TRIES):
            try:
                case = _outside(rng, strange) if outside else _inside(rng)
            except ValueError:
                continue
            out.append(case)
            break
    return out


def _outside(rng: np.random.Generator, names: list[str]) -> Case:
    name = names[int(rng.integers(len(names)))]
    return _made(name, None, STRANGE[name], float(rng.uniform(0.9, 1.6)), _rub(rng))


def _rub(rng: np.random.Generator) -> float:
    return float(rng.choice([0.0, 0.02, 0.05]))


def _inside(rng: np.random.Generator) -> Case:
    """A law of one or two words of the grammar.

    Raises:
        ValueError: nothing swings, or a word has next to no part in it.
    """
    positive = bool(rng.random() < 0.3)
    vocabulary = [term for term in words(positive) if len(term.columns) == 1]
    picked = rng.choice(len(vocabulary), int(rng.choice([1, 2, 2])), replace=False)
    terms = [vocabulary[k] for k in picked]
    constants = [tuple(_constant(rng, kind) for kind in term.constants) for term in terms]
    x = np.linspace(0.6, 2.4, 50) if positive else np.linspace(-1.5, 1.5, 50)
    sizes = [float(np.std(term.columns[0](x, p))) for term, p in zip(terms, constants, strict=True)]
    if not np.isfinite(sizes).all() or min(sizes) < 1e-3:
        raise ValueError("flat")
    signs = rng.choice([-1.0, 1.0], len(terms))
    strengths = rng.uniform(0.6, 2.0, len(terms)) * signs / np.array(sizes)
    force = _force(terms, constants, strengths)
    begin = float(rng.uniform(1.2, 2.2) if positive else rng.uniform(0.9, 1.6))
    name = " + ".join(t.name for t in terms)
    case = _made(name, None, force, begin, _rub(rng), positive)
    places = case.recording(0)[0][0]
    if positive and places.min() < 0.3:
        raise ValueError("too near")
    parts = [
        np.std(c * term.columns[0](places, p))
        for c, term, p in zip(strengths, terms, constants, strict=True)
    ]
    if min(parts) < LEAST * np.std(force(places)):
        raise ValueError("a word without a part")
    kind = tuple(sorted(term.name for term in terms))
    return Case(case.name, kind, force, case.friction, begin, case.scale)


def _constant(rng: np.random.Generator, kind: str) -> float:
    return float(
        {
            "rate": lambda: rng.uniform(0.8, 4.0),
            "either": lambda: rng.uniform(0.5, 2.0) * rng.choice([-1, 1]),
            "place": lambda: rng.uniform(-0.5, 0.8),
            "power": lambda: rng.choice([0.7, 1.3, 1.7, 2.3]),
            "signed power": lambda: rng.choice([-2.4, -1.3, 0.7, 1.3]),
        }[kind]()
    )


def _force(terms: list[Term], constants: list[tuple[float, ...]], strengths: np.ndarray) -> Force:
    def force(x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            parts = [
                c * term.columns[0](x, p)
                for c, term, p in zip(strengths, terms, constants, strict=True)
            ]
        return np.sum(parts, axis=0)

    return force
