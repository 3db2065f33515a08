"""Equations on paper: their forces are those that are fitted, and each number has its letter."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest

from vidphys.diagnose.explanations.equations import FALLS, of_law, of_terms
from vidphys.diagnose.inference.menu import (
    FRICTIONS,
    SHAPES,
    TWO_FRICTIONS,
    TWO_SHAPES,
    external_terms,
    of_each_body,
    pair_term,
    together,
)
from vidphys.diagnose.mechanisms.charts import Angle, Line, Plane, Turned
from vidphys.diagnose.mechanisms.impacts.colliding import Colliding
from vidphys.diagnose.mechanisms.law import Law
from vidphys.diagnose.mechanisms.terms import Wall

POWERS = {"¹³": "**13", "⁷": "**7", "³": "**3", "²": "**2", "^": "**"}


def computed(text, **letters):
    """What a formula gives, read as one reads it on paper."""
    text, _, ends = text.partition(" within ")
    for mark, power in POWERS.items():
        text = text.replace(mark, power)
    product = re.sub(r"(?<=[\w)])\s+(?=[\w(])", "*", text)
    value = eval(product, {"exp": np.exp}, letters)  # of this module's own formulas
    return value * (letters["d"] < letters[ends]) if ends else value


@pytest.mark.parametrize("shape", FALLS)
def test_a_pull_on_paper_is_the_one_that_is_fitted(shape):
    d = np.linspace(0.2, 2.0, 19)
    letters = {"k": 0.7, "K": 0.7, "s": 0.9, "D": 0.9, "c": -1.1, "b": 0.7, "a": -1.1}
    shapes, _ = TWO_SHAPES.get(shape, ((shape,), ()))
    fitted = sum(x * SHAPES[name](d, 0.9) for x, name in zip((0.7, -1.1), shapes, strict=False))
    written = computed(FALLS[shape], d=d, **letters) * np.ones_like(d)
    np.testing.assert_allclose(written, fitted * d, rtol=1e-12, atol=1e-12)


def inferred(terms, bodies=1, space=2, mass=1.0, bathed=False):
    """What looks like an inference of these terms."""
    by = {term.family: term for term in terms}
    windows = SimpleNamespace(
        frames=np.zeros((1, 4, bodies, space)), mass=mass * np.arange(1.0, bodies + 1) ** (mass > 1)
    )
    structure = SimpleNamespace(term=by.get)
    return SimpleNamespace(windows=windows, structure=structure, terms=terms, bathed=bathed)


PULL, PUSH = pair_term("inverse-square", 0.2, "mass"), pair_term("contact", 0.5, "alike")
OUTSIDE = {term.kind: term for space in (1, 2) for term in external_terms(space, False)}
SWING = external_terms(1, True)[-1]
WRITTEN = [
    (inferred([]), "r'' = 0"),
    (inferred([OUTSIDE["uniform"], FRICTIONS["square"]]), "r'' = g - β |r'| r'"),
    (inferred([OUTSIDE["trap"], FRICTIONS["dry"]]), "r'' = -κ (r - r₀) - f r'/|r'|"),
    (inferred([OUTSIDE["well"]], space=1), "x'' = -κ x + a + b x² - c x³"),
    (inferred([SWING, TWO_FRICTIONS[1]], space=1),
     "θ'' = -a sin θ + b cos θ - γ θ' - f sign θ'"),
    (inferred([FRICTIONS["linear"]], bathed=True), "r'' = -γ r' + √(2 γ T) ξ(t)"),
    (inferred([PULL, OUTSIDE["uniform"]], bodies=3),
     "rᵢ'' = Σⱼ (k d/(d² + s²)^(3/2)) (rⱼ - rᵢ)/d + g, d = |rⱼ - rᵢ|"),
    (inferred([PULL, of_each_body(FRICTIONS["linear"], 2)], bodies=2, mass=2.0),
     "mᵢ rᵢ'' = Σⱼ mᵢ mⱼ (k d/(d² + s²)^(3/2)) (rⱼ - rᵢ)/d - γᵢ rᵢ', d = |rⱼ - rᵢ|"),
    (inferred([together(PULL, PUSH)], bodies=2),
     "rᵢ'' = Σⱼ (k d/(d² + s²)^(3/2) - K (D - d) within D) (rⱼ - rᵢ)/d, d = |rⱼ - rᵢ|"),
]  # fmt: skip


@pytest.mark.parametrize(("inference", "text"), WRITTEN)
def test_terms_of_the_menu_stand_in_an_equation_and_each_number_has_its_letter(inference, text):
    names = [name for term in inference.terms for name in term.named]
    lengths = [f"{term.kind}: length" for term in inference.terms if term.scale is not None]
    found = of_terms(inference, [*names, *lengths])
    assert found.text == text
    without = [x for x in (*names, *lengths) if x not in found.symbols]
    assert all(x.startswith("trap: centre pull") for x in without)  # the place r₀ by other numbers
    assert all(symbol[0] in text for symbol in found.symbols.values())


def fitted(law, chart, bodies=1, known=None):
    inputs = None if known is None else SimpleNamespace(names=known)
    model = SimpleNamespace(law=law, charts=[chart] * bodies)
    return SimpleNamespace(model=model, clips=[SimpleNamespace(inputs=inputs)])


LEVEL = Line((1.0, 0.0))
LAWS = [
    (fitted(Law(1, "pendulum", "linear+square"), Angle()), ["rate", "period", "linear friction"],
     "θ'' = -ω² sin θ - γ θ' - β |θ'| θ'", {"rate": "ω", "linear friction": "γ"}),
    (fitted(Law(2, "uniform", walls=(Wall((0.0, -1.0)),)), Plane(2)),
     ["acceleration", "restitution"],
     "r'' = g; at a wall r' → -e r' across it", {"acceleration": "g", "restitution": "e"}),
    (fitted(Law(2, "trap", apart=True), Turned((1.0, 0.0))), ["rate 1", "rate 2"],
     "sₖ'' = -ωₖ² (sₖ - sₖ₀) along each direction k", {"rate 1": "ω₁", "rate 2": "ω₂"}),
    (fitted(Law(2, "trap", "linear", apart=True, coupled=True), LEVEL, 2),
     ["rate 1", "linear friction", "rate of the spring between", "mass ratio"],
     "sᵢ'' = -ωᵢ² (sᵢ - sᵢ₀) - γ sᵢ' - Σⱼ ωᵢⱼ² mⱼ/(mᵢ + mⱼ) (sᵢ - sⱼ)",
     {"rate 1": "ω₁", "linear friction": "γ", "rate of the spring between": "ωᵢⱼ"}),
    (fitted(Law(2, "string"), Plane(2)), ["rate", "period", "length", "acceleration"],
     "r'' = g - τ (r - p), τ ≥ 0 such that |r - p| ≤ ℓ", {"length": "ℓ", "acceleration": "g"}),
    (fitted(Law(2, "elastic"), Plane(2)), ["rate", "rest length", "acceleration"],
     "r'' = g - ω² (1 - ℓ₀/|r - p|) (r - p)",
     {"rate": "ω", "rest length": "ℓ₀", "acceleration": "g"}),
    (fitted(Law(2, "none", "dry", turning=True), Plane(2)), ["dry friction", "turning"],
     "r'' = -f r'/|r'| + Ω × r'", {"dry friction": "f", "turning": "Ω"}),
    (fitted(Law(2, "centre"), Plane(2)),
     ["acceleration at the nearest distance", "power of the distance", "nearest distance"],
     "r'' = a (d/|r - p|)^n (r - p)/|r - p|",
     {"acceleration at the nearest distance": "a", "power of the distance": "n",
      "nearest distance": "d"}),
    (fitted(Law(1, "trap", inputs=1), LEVEL, known=("motor",)), ["acceleration by one motor"],
     "s'' = -ω² (s - s₀) + b motor(t)", {"acceleration by one motor": "b"}),
    (fitted(Colliding(4, friction="linear"), Plane(2), 2), ["linear friction 2", "restitution"],
     "rᵢ'' = -γᵢ rᵢ'; where two meet, rᵢ' - rⱼ' → -e (rᵢ' - rⱼ') along their line",
     {"linear friction 2": "γ₂", "restitution": "e"}),
]  # fmt: skip


@pytest.mark.parametrize(("fit", "names", "text", "symbols"), LAWS)
def test_a_law_stands_in_an_equation_with_the_letters_of_its_numbers(fit, names, text, symbols):
    found = of_law(fit, names)
    assert (found.text, found.symbols) == (text, symbols)


def test_two_rods_stand_in_two_equations_that_their_motion_keeps():
    law = Law(2, "chain", "linear", apart=True)
    names = {"rate 1": "ω₁", "rate 2": "ω₂", "linear friction": "γ", "inertia ratio": "a"}
    found = of_law(fitted(law, Angle(), 2), [*names, "mass ratio"])
    assert found.symbols == names
    told = {"swing 1": 30.0, "swing 2": 9.0, "link": 0.3, "inertia": 0.25, "linear": 0.4}
    values = np.array([told[name] for name in law.names])
    times = np.arange(200) * 1e-4
    states = law.roll(values, np.array([[1.1, -0.4], [2.0, 3.0]]), times)
    letters = {"a": 0.25, "b": 0.3, "γ": 0.4, "ω₁": 30.0**0.5, "ω₂": (9.0 / 0.25) ** 0.5}
    angles, rates = states[1:-1, 0].T, states[1:-1, 1].T
    bends = ((states[2:, 1] - states[:-2, 1]) / (times[2:] - times[:-2])[:, None]).T
    for k, mark in enumerate("₁₂"):
        letters |= {f"θ{mark}": angles[k], f"θ{mark}'": rates[k], f"θ{mark}''": bends[k]}
    letters["Δ"] = angles[0] - angles[1]
    for equation in found.text.split("; ")[:2]:
        left, right = (by_parts(side, letters) for side in equation.split(" = "))
        np.testing.assert_allclose(left, right, rtol=1e-5, atol=1e-4)


def by_parts(text, letters):
    """What a side of an equation gives, whose letters may have dashes behind them."""
    names = {name: f"q{k}" for k, name in enumerate(sorted(letters, key=len, reverse=True))}
    text = text.replace("cos ", "cos@").replace("sin ", "sin@").replace("²", "**2")
    for name, plain in names.items():
        text = text.replace(name, plain)
    text = re.sub(r"(cos|sin)@(\w+)", r"\1(\2)", text)
    product = re.sub(r"(?<=[\w)])\s+(?=[\w(])", "*", text)
    known = {plain: letters[name] for name, plain in names.items()}
    return eval(product, {"sin": np.sin, "cos": np.cos}, known)  # of this module's own equations


def test_letters_are_said_once():
    found = of_law(LAWS[2][0], ["rate 1", "rate 2"])
    assert found.line.endswith("(ω rate)")
    assert of_law(LAWS[5][0], ["rest length"]).line.endswith("(ℓ₀ rest length)")
