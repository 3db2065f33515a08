"""The models that terms of the menu stand for have the forces that were fitted."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from dynamics import Parameters, PhaseState, build, terms
from vidphys.diagnose.explanations.menu_model import model_of, shaped
from vidphys.diagnose.explanations.menu_numbers import number_lines, quantities_of
from vidphys.diagnose.inference.menu import (
    FRICTIONS,
    PAIR,
    Field,
    external_terms,
    pair_term,
    pair_terms,
    together,
)
from vidphys.diagnose.recordings.units import Units

RNG = np.random.default_rng(3)
PLACES = RNG.uniform(-1, 1, (5, 1, 3, 2))  # (w, m, n, d)
MASS = RNG.uniform(0.5, 2.0, (5, 3))
FIELD = Field(PLACES, PLACES, np.zeros((5, 1)), MASS, np.full(5, -1.3))
LAW = Parameters(torch.full((5,), -1.3, dtype=torch.float64), torch.tensor(MASS))


@pytest.mark.parametrize("source", ["mass", "alike"])
def test_every_pair_force_of_the_menu_has_its_model(source):
    state = PhaseState(torch.tensor(PLACES[:, 0]), torch.zeros(5, 3, 2).double())
    kinds = set()
    for term in pair_terms(FIELD.distance, source):
        strengths = RNG.uniform(0.5, 1.5, len(term.coefficients))
        found = (term.columns(FIELD) @ strengths)[:, 0]
        model = terms.Hamiltonian(potentials=tuple(shaped(term, strengths)))
        fixed = model.throughout(learned=False)
        force = build(fixed, 3, 0.01).force(state, LAW).numpy()
        np.testing.assert_allclose(force / MASS[..., None], found, rtol=1e-9, atol=1e-12)
        kinds.add(term.shape)
    assert len(kinds) == 11


@pytest.mark.parametrize(
    "shape, explained, model",
    [
        ("spring", True, terms.Shaped("mass", shape="spring", strength=0.7)),
        ("spring", False, terms.Radial()),
        ("contact", True, terms.Shaped("mass", shape="contact", strength=0.7, length=0.3)),
        ("contact", False, terms.Knots(reach=0.3)),
    ],
)
def test_a_force_that_leaves_more_than_noise_is_learned_anew(shape, explained, model):
    pair = pair_term(shape, 0.3 if shape == "contact" else None, "mass")
    structure = SimpleNamespace(
        term=lambda family: pair if family == PAIR else None, of=lambda _: np.array([0.7])
    )
    found = SimpleNamespace(
        structure=structure, kinds={pair.kind}, leftover=SimpleNamespace(explained=explained)
    )
    assert model_of(found).potentials == (model,)


def counted(field, length, seconds):
    """The same motion where the unit of length and the second are so much longer."""
    return replace(field, q=field.q / length, v=field.v * seconds / length)


TERMS = [*pair_terms(FIELD.distance, "mass"), *external_terms(2, False), *FRICTIONS.values()]


@pytest.mark.parametrize(
    ("space", "term"),
    [*((2, term) for term in TERMS), *((1, term) for term in external_terms(1, False))],
    ids=lambda x: getattr(x, "name", x),
)
def test_in_another_unit_a_number_is_told_as_its_powers_say(space, term):
    length, seconds = 3.0, 0.7
    fitted = SimpleNamespace(place=lambda _: 0, values=np.full(9, 0.7), errors=np.full(9, 0.1))
    found = SimpleNamespace(fitted=fitted, terms=(term,), bathed=False)
    told = quantities_of(found)[: len(term.coefficients)]
    numbers = [x.value / length**x.length / seconds**x.seconds for x in told]
    field = replace(FIELD, q=FIELD.q[..., :space], v=FIELD.v[..., :space])
    finer = term if term.scale is None else scaled(term, 1 / length)
    same = (finer.columns(counted(field, length, seconds)) @ numbers) * length / seconds**2
    expected = term.columns(field) @ np.full(len(numbers), 0.7)
    np.testing.assert_allclose(same, expected, rtol=1e-9, atol=1e-12)


def scaled(term, factor):
    """The same pair force with its lengths times a factor."""
    if term.parts:
        return together(*(scaled(part, factor) for part in term.parts))
    return term.remade(term.scale * factor)


def test_numbers_from_a_picture_are_told_in_its_unit():
    fitted = SimpleNamespace(place=lambda _: 0, values=np.full(9, 0.7), errors=np.full(9, 0.1))
    terms = (external_terms(2, False)[0], FRICTIONS["linear"], pair_term("spring", None, "mass"))
    found = SimpleNamespace(fitted=fitted, terms=terms, bathed=False)
    assert number_lines(found, Units("px", 640.0)) == [
        "uniform: x 450 ± 130 px/s², y 450 ± 130 px/s² (95 %)",
        "linear: rate 0.70 ± 0.20 1/s (95 %)",
        "pair: strength 0.70 ± 0.20 1/s² (95 %)",
    ]


def test_an_unknown_length_has_its_place_in_a_unit():
    powers = [(1, 0), (1, -1), (3, -2), (-1, 0), (0, -2), (0, 0)]
    told = [Units().named(*each) for each in powers]
    assert told == ["", "length/s", "length³/s²", "1/length", "1/s²", ""]
