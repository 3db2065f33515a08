"""What was found, as an equation of motion on paper, with the letters of its numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vidphys.diagnose.inference.inference import Inference
from vidphys.diagnose.inference.menu import EXTERNAL, FRICTION, PAIR, Term
from vidphys.diagnose.mechanisms.charts import Turned
from vidphys.diagnose.mechanisms.fitted import Fit
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.law import Law

LETTERS = {  # of numbers by their names, without the number of a body or of a direction
    "rate": "ω",
    "linear friction": "γ",
    "square friction": "β",
    "dry friction": "f",
    "friction coefficient": "μ",
    "acceleration": "g",
    "rest length": "ℓ₀",
    "length": "ℓ",
    "acceleration at the nearest distance": "a",
    "nearest distance": "d",
    "power of the distance": "n",
    "turning": "Ω",
    "lift over speed, at first": "λ",
    "strongest acceleration by what drives it": "A",
    "rate of what drives it": "σ",
    "rate of the spring": "ωᵢⱼ",
    "inertia ratio": "a",
    "link ratio": "b",
    "restitution": "e",
    "tangential restitution": "eₜ",
    # of the menu
    "pair: strength": "k",
    "pair: length": "s",
    "pair: stiffness": "k",
    "pair: offset": "c",
    "pair: repulsion": "b",
    "pair: attraction": "a",
    "contact: strength": "K",
    "contact: length": "D",
    "pair+contact: length": "D",
    "trap: stiffness": "κ",
    "well: stiffness": "κ",
    "well: push": "a",
    "well: second": "b",
    "well: third": "c",
    "pendulum: hanging": "a",
    "pendulum: aside": "b",
    "linear: rate": "γ",
    "square: rate": "β",
    "dry: rate": "f",
    "bath: temperature": "T",
    "uniform": "g",
}
GAIN = "acceleration by one"  # of a known input, whose name comes behind
FALLS = {  # of a pair force of the menu: its pull at the distance d
    "point": "k/d²",
    "inverse-square": "k d/(d² + s²)^(3/2)",
    "inverse": "k d/(d² + s²)",
    "inverse-cube": "k d/(d² + s²)²",
    "gaussian": "k d exp(-d²/(2 s²))",
    "cut-off": "k d (1 - d²/s²)² within s",
    "spring": "k d",
    "rest-length": "k d + c",
    "lennard-jones": "a/d⁷ - b/d¹³",
    "contact": "- K (D - d) within D",
}
BELOW = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
# A name, and of which body, pair, direction or axis it is.
NAMED = re.compile(
    r"(?P<root>.*?)(?: (?P<number>\d+)| between(?: \d+ and \d+)?| about [xyz]|: [xyz])?"
)


@dataclass(frozen=True)
class Equation:
    """An equation of motion.

    Args:
        text: of it.
        symbols: of the numbers that stand in it, by their names.
    """

    text: str
    symbols: Mapping[str, str]

    @property
    def line(self) -> str:
        """With what its letters are."""
        letters: dict[str, str] = {}
        for name, symbol in self.symbols.items():
            root, number = _parted(name)
            letters.setdefault(symbol.removesuffix(number.translate(BELOW)), root)
        said = ", ".join(f"{letter} {name}" for letter, name in letters.items())
        return f"{self.text}   ({said})" if said else self.text

    @property
    def data(self) -> dict[str, Any]:
        """As a file keeps it."""
        return {"text": self.text, "symbols": dict(self.symbols)}


def _parted(name: str) -> tuple[str, str]:
    """What a number is, and the number of the body or direction that it is of, if any."""
    found = NAMED.fullmatch(name)
    assert found is not None  # anything matches
    return found["root"], found["number"] or ""


def with_letters(text: str, names: Iterable[str], letters: Mapping[str, str] = LETTERS) -> Equation:
    """An equation, and the letters of those numbers that stand in it."""
    symbols = {}
    for name in names:
        root, number = _parted(name)
        letter = letters.get(root, "")
        if letter and letter in text:
            symbols[name] = letter + number.translate(BELOW)
    return Equation(text, symbols)


def of_law(fit: Fit, names: Iterable[str]) -> Equation:
    """Of a fitted law.

    Args:
        fit: of the law.
        names: of the numbers that are told.
    """
    law, chart = fit.model.law, fit.model.charts[0]
    if law.restoring == "chain":
        return with_letters(_of_rods(law), names)
    several, turned = len(fit.model.charts) > 1, isinstance(chart, Turned)
    which = "ₖ" if turned else "ᵢ" if several else ""
    own = which if law.apart else ""
    plane = chart.name == "plane" and chart.size > 1
    letter = "θ" if chart.name in ("arc", "angle") else "r" if plane else "s"
    q = letter + which
    pulls = [_restoring(law, q, own), *_frictions(law, q, which)]
    gains = _gains(fit)
    pulls += [*_pushes(law, q), *(f"+ {b} {name}(t)" for name, b in gains.items())]
    if law.coupled:
        pulls.append(f"- Σⱼ ωᵢⱼ² mⱼ/(mᵢ + mⱼ) ({q} - {letter}ⱼ)")
    text = f"{q}'' = {_sum(pulls)}"
    if turned:
        text += " along each direction k"
    if law.restoring == "string":
        text += f", τ ≥ 0 such that |{q} - p| ≤ ℓ"
    if law.loose:
        text += "; ωᵢ = 0 of those that springs between them hold alone"
    if law.walls:
        text += f"; at a wall {q}' → -e {q}' across it"
    if isinstance(law, Colliding):
        text += f"; where two meet, {q}' - {letter}ⱼ' → -e ({q}' - {letter}ⱼ') along their line"
    told = {f"{GAIN} {name}": letter for name, letter in gains.items()}
    return with_letters(text, names, LETTERS | told)


def _of_rods(law: Law) -> str:
    """Of two rods that hang end on end, by their angles, as the fit has them."""
    upper = _sum(["- ω₁² sin θ₁", *_frictions(law, "θ₁", "")])
    lower = _sum(["- a ω₂² sin θ₂", *_frictions(law, "θ₂", "")])
    return (
        f"θ₁'' + b (θ₂'' cos Δ + θ₂'² sin Δ) = {upper}; "
        f"a θ₂'' + b (θ₁'' cos Δ - θ₁'² sin Δ) = {lower}; "
        "Δ = θ₁ - θ₂; of weights on rods without mass b = λ m₂/(m₁ + m₂), a = λ b, λ = ℓ₂/ℓ₁"
    )


def _restoring(law: Law, q: str, own: str) -> str:
    """The acceleration by where a body is."""
    w = f"ω{own}²"
    return {
        "none": "",
        "uniform": "g" if law.curve is None else "g·t(s)",
        "trap": f"- {w} ({q} - {q}₀)",
        "pendulum": f"- {w} sin {q}",
        "elastic": f"g - {w} (1 - ℓ₀/|{q} - p|) ({q} - p)",
        "string": f"g - τ ({q} - p)",
        "centre": f"a (d/|{q} - p|)^n ({q} - p)/|{q} - p|",
    }[law.restoring]


def _frictions(law: Law, q: str, which: str) -> list[str]:
    own = which if isinstance(law, Colliding) else ""
    rubs = law.curve is not None  # by what presses it to the curve
    return [
        f"- μ N sign {q}'" if kind == "dry" and rubs else _resisting(kind, q, own)
        for kind in law.frictions
    ]


def _pushes(law: Law, q: str) -> list[str]:
    pushes = [f"+ Ω × {q}'"] if law.turning else []
    pushes += [f"+ λ(t) ẑ × {q}'"] if law.lift_fades is not None else []
    return [*pushes, "+ A cos(σ t + φ)"] if law.forced else pushes


def _gains(fit: Fit) -> dict[str, str]:
    """The letter of what each known input is multiplied by."""
    known = fit.clips[0].inputs
    names = () if known is None or not fit.model.law.inputs else known.names
    return {name: "b" + "'" * i for i, name in enumerate(names)}


def of_terms(inference: Inference, names: Iterable[str]) -> Equation:
    """Of terms of the menu, for masses that may differ.

    Args:
        inference: what was found.
        names: of the numbers that are told.
    """
    windows, structure = inference.windows, inference.structure
    bodies, space = windows.frames.shape[2:]
    equal = bool(np.allclose(windows.mass, 1.0))
    which = "ᵢ" if bodies > 1 else ""
    pair, outside, friction = (structure.term(x) for x in (PAIR, EXTERNAL, FRICTION))
    angle = outside is not None and outside.kind == "pendulum"
    letter = "θ" if angle else "x" if space == 1 else "r"
    q, m = letter + which, "" if equal else f"m{which} "
    pulls = [] if pair is None else [_pair(pair, letter, "" if equal else "mᵢ mⱼ ")]
    pulls += [] if outside is None else [_outside(outside.kind, q, m)]
    if friction is not None and friction in inference.terms:
        pulls += [_resisting(kind, q, which if friction.apart else "") for kind in friction.kinds]
    if inference.bathed:
        pulls.append("+ √(2 γ T) ξ(t)")
    apart = "" if pair is None else f", d = |{letter}ⱼ - {q}|"
    return with_letters(f"{m}{q}'' = {_sum(pulls)}{apart}", names)


def _pair(term: Term, letter: str, masses: str) -> str:
    pulls = [FALLS[shape] for shape in term.shape.split("+")]
    many = f"({_sum(pulls)})" if len(pulls) > 1 or " " in pulls[0] else pulls[0]
    both = masses if term.source == "mass" else ""
    return f"Σⱼ {both}{many} ({letter}ⱼ - {letter}ᵢ)/d"


def _outside(kind: str, q: str, m: str) -> str:
    swing = f"- a sin {q} + b cos {q}"
    return {
        "uniform": f"{m}g",
        "trap": f"- κ ({q} - {q}₀)",
        "well": f"- κ {q} + a + b {q}² - c {q}³",
        "pendulum": f"{m}({swing})" if m else swing,
    }[kind]


def _resisting(kind: str, q: str, own: str) -> str:
    direction = f"{q}'/|{q}'|" if q[0] == "r" else f"sign {q}'"
    return {
        "linear": f"- γ{own} {q}'",
        "square": f"- β{own} |{q}'| {q}'",
        "dry": f"- f{own} {direction}",
    }[kind]


def _sum(parts: Iterable[str]) -> str:
    """Accelerations one after the other, each with its sign.

    Example:
        >>> _sum(["- ω² θ", "g", "- γ θ'"])
        "-ω² θ + g - γ θ'"
    """
    text = ""
    for part in parts:
        if part:
            signed = part if part[:2] in ("- ", "+ ") else f"+ {part}"
            text += f" {signed}"
    return re.sub(r"^ \+ ", "", re.sub(r"^ - ", "-", text)) or "0"
